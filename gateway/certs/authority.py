"""X.509 without files: a private CA, the gateway's and laptops' certificates, and reading them back.

Zenoh's access control identifies a laptop by the first common name of its certificate, its own (access.py). The
laptop's name, or its person's, is in the organizational unit.
"""

import datetime as dt
import ipaddress
import re
import secrets
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import CertificatePublicKeyTypes
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID, ObjectIdentifier

from gateway.certs import CA_DAYS, CONSOLE_DAYS
from gateway.certs.access import role_of
from gateway.errors import ConfigError

GATEWAY = "gateway"
CA = "ca"
CONSOLE = "console"

# A robot without a network and a battery-backed clock starts with the time of its last shutdown or of its image. At
# that time, a certificate of today is not valid yet. So all certificates start a year early.
BACKDATE = dt.timedelta(days=365)

_Kind = TypeVar("_Kind", bound=x509.ExtensionType)
_ORGANIZATION = "hexapod-gateway"
_LABEL = re.compile(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?")
_Extension = tuple[x509.ExtensionType, bool]
"""An extension, and whether it is critical."""


@dataclass(frozen=True)
class KeyPair:
    """A certificate and its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    def certificate_pem(self) -> bytes:
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    def key_pem(self) -> bytes:
        """PKCS #8, not encrypted: a service that starts at boot cannot be given a passphrase."""
        return self.key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )


def make_ca(now: dt.datetime, hosts: Sequence[str] = ()) -> KeyPair:
    """Return a new CA for leaf certificates only. Its name has a random part, so that two CAs are never confused.

    With `hosts` the CA is for browsers, and valid only for these servers: its key is worthless for any other host.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    extensions: list[_Extension] = [(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)]
    if hosts:
        # A kind of name without an entry is not constrained, so each gets an unused one.
        permitted = [_general_name(host, ipaddress.ip_network) for host in (*hosts, "invalid", "255.255.255.255")]
        extensions += [(x509.NameConstraints(permitted, None), True), (_usage(CONSOLE), False)]
    subject = _name(f"{_ORGANIZATION} CA {secrets.token_hex(4)}", CONSOLE if hosts else CA)
    span = (now - BACKDATE, now + dt.timedelta(days=CA_DAYS))
    return KeyPair(_signed(subject, key, subject, key.public_key(), span, extensions, is_ca=True), key)


def make_leaf(ca: KeyPair, common_name: str, name: str, hosts: Sequence[str], days: int, now: dt.datetime) -> KeyPair:
    """Return a new certificate of a robot (GATEWAY), console (CONSOLE) or laptop; as a server valid for `hosts`."""
    key = ec.generate_private_key(ec.SECP256R1())
    return KeyPair(sign(ca, _name(common_name, name), key.public_key(), hosts, days, now), key)


def sign(
    ca: KeyPair, subject: x509.Name, key: CertificatePublicKeyTypes, hosts: Sequence[str], days: int, now: dt.datetime
) -> x509.Certificate:
    """Return a leaf certificate of this holder and key with a new serial number; as a server valid for `hosts`."""
    issuer, common_name = ca.certificate, _attribute(subject, NameOID.COMMON_NAME)
    days = min(days, CONSOLE_DAYS) if common_name == CONSOLE else days
    # A leaf that outlives its CA would be rejected while `certs list` still shows it as good.
    end = min(now + dt.timedelta(days=days), issuer.not_valid_after_utc)
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(ca.key.public_key())
    extensions: list[_Extension] = [(authority, False), (_usage(common_name), False)]
    if hosts:
        extensions.append((x509.SubjectAlternativeName([_general_name(host) for host in hosts]), False))
    span = (max(now - BACKDATE, issuer.not_valid_before_utc), end)
    return _signed(issuer.subject, ca.key, subject, key, span, extensions, is_ca=False)


def _usage(common_name: str) -> x509.ExtendedKeyUsage:
    """A robot also dials other Zenoh programs. A laptop is only a client, so it cannot pose as the robot."""
    server, client = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
    return x509.ExtendedKeyUsage({GATEWAY: [server, client], CONSOLE: [server]}.get(common_name, [client]))


def _signed(
    issuer: x509.Name,
    signer: ec.EllipticCurvePrivateKey,
    subject: x509.Name,
    key: CertificatePublicKeyTypes,
    span: tuple[dt.datetime, dt.datetime],
    more: Sequence[_Extension],
    *,
    is_ca: bool,
) -> x509.Certificate:
    """`span`: begin and end."""
    usage = x509.KeyUsage(not is_ca, False, False, False, False, is_ca, is_ca, False, False)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(issuer).public_key(key)
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(span[0]).not_valid_after(span[1])
    for extension, critical in ((x509.BasicConstraints(is_ca, 0 if is_ca else None), True), (usage, True), *more):
        builder = builder.add_extension(extension, critical=critical)
    return builder.sign(signer, hashes.SHA256())


def is_issued(certificate: x509.Certificate, ca: x509.Certificate) -> bool:
    """Return whether this CA signed the certificate."""
    with suppress(ValueError, TypeError, InvalidSignature):
        certificate.verify_directly_issued_by(ca)
        return True
    return False


def is_ca(certificate: x509.Certificate) -> bool:
    """Return whether the certificate may sign others."""
    found = _extension(certificate, x509.BasicConstraints)
    return found is not None and found.ca


def parse_hosts(texts: Sequence[str]) -> list[str]:
    """Return host names in lower case and plain IP addresses, each once. Raises ConfigError for any other text."""
    return list(dict.fromkeys(map(_parse_host, texts)))


def _parse_host(text: str) -> str:
    host = text.strip().strip("[]").lower()
    name, address = host.removesuffix("."), _address(host)
    if address is not None and not address.is_unspecified and "%" not in host:  # a zone counts on this machine only
        return str(address)
    labels = name.split(".")
    # A last label of digits only is a mistyped address (192.0.2.999), never a host name.
    if address is None and all(map(_LABEL.fullmatch, labels)) and not labels[-1].isdigit() and len(host) < 254:
        return name
    fix = "give what laptops dial, such as robot.local or 192.0.2.7 (no port, no tls/)"
    raise ConfigError(f"{text!r} is neither a host name nor an IP address: {fix}")


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """Return the names and addresses that a gateway's certificate is valid for, in the order they were given."""
    names = _extension(certificate, x509.SubjectAlternativeName) or ()
    return [str(name.value) for name in names if isinstance(name, x509.DNSName | x509.IPAddress)]


class Holder(NamedTuple):
    """The holder of a certificate. One person may have several, each with a common name of its own."""

    common_name: str
    name: str

    @property
    def role(self) -> str:
        """The common name without a laptop's number."""
        return role_of(self.common_name)


def holder_of(certificate: x509.Certificate) -> Holder:
    """Return ("ca", its name), ("gateway", its first host), or a laptop's (common name, name); "" if absent."""
    common = _attribute(certificate.subject, NameOID.COMMON_NAME)
    unit = _attribute(certificate.subject, NameOID.ORGANIZATIONAL_UNIT_NAME)
    if is_ca(certificate):
        return Holder(CA, common)
    return Holder(common, next(iter(hosts_of(certificate)), unit) if common == GATEWAY else unit)


def _extension(certificate: x509.Certificate, kind: type[_Kind]) -> _Kind | None:
    with suppress(x509.ExtensionNotFound):
        return certificate.extensions.get_extension_for_class(kind).value
    return None


def _name(common_name: str, unit: str) -> x509.Name:
    oids = (NameOID.COMMON_NAME, NameOID.ORGANIZATIONAL_UNIT_NAME, NameOID.ORGANIZATION_NAME)
    return x509.Name(list(map(x509.NameAttribute, oids, (common_name, unit, _ORGANIZATION))))


def _attribute(name: x509.Name, oid: ObjectIdentifier) -> str:
    return next((str(attribute.value) for attribute in name.get_attributes_for_oid(oid)), "")


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    with suppress(ValueError):
        return ipaddress.ip_address(host)
    return None


def _general_name(host: str, kind: Callable[[str], Any] = ipaddress.ip_address) -> x509.GeneralName:
    """Return the name, or the address as `kind` has it: alone, or as a network of one address."""
    return x509.DNSName(host) if _address(host) is None else x509.IPAddress(kind(host))
