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
from pathlib import Path
from typing import Any, NamedTuple

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

_ORGANIZATION = "hexapod-gateway"
_LABEL = r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
# A last label of digits only is a mistyped address (192.0.2.999), never a host name.
_HOST = re.compile(rf"(?=.{{1,253}}\Z)({_LABEL}\.)*(?!\d+\Z){_LABEL}")


class KeyPair(NamedTuple):
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

    def files(self, stem: Path) -> dict[Path, bytes]:
        """Return the two files of the pair: the key (0600) and the certificate."""
        contents = {"key": self.key_pem(), "pem": self.certificate_pem()}
        return {stem.with_name(f"{stem.name}.{suffix}"): data for suffix, data in contents.items()}


def make_ca(now: dt.datetime, hosts: Sequence[str] = ()) -> KeyPair:
    """Return a new CA for leaf certificates only. Its name has a random part, so that two CAs are never confused.

    With `hosts` the CA is for browsers, and valid only for these servers: its key is worthless for any other host.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    public, end = key.public_key(), now + dt.timedelta(days=CA_DAYS)
    subject = _name(f"{_ORGANIZATION} CA {secrets.token_hex(4)}", CONSOLE if hosts else CA)
    builder = _builder(subject, public, now - BACKDATE, end, is_ca=True).issuer_name(subject)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
    if hosts:
        # A kind of name without an entry is not constrained, so each gets an unused one.
        permitted = [_general_name(host, ipaddress.ip_network) for host in (*hosts, "invalid", "255.255.255.255")]
        builder = builder.add_extension(x509.NameConstraints(permitted, None), critical=True)
        builder = builder.add_extension(_usage(CONSOLE), critical=False)
    return KeyPair(builder.sign(key, hashes.SHA256()), key)


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
    start = max(now - BACKDATE, issuer.not_valid_before_utc)
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(ca.key.public_key())
    builder = _builder(subject, key, start, end, is_ca=False).issuer_name(issuer.subject)
    builder = builder.add_extension(authority, critical=False).add_extension(_usage(common_name), critical=False)
    if hosts:
        builder = builder.add_extension(x509.SubjectAlternativeName(map(_general_name, hosts)), critical=False)
    return builder.sign(ca.key, hashes.SHA256())


def _usage(common_name: str) -> x509.ExtendedKeyUsage:
    """A robot also dials other Zenoh programs. A laptop is only a client, so it cannot pose as the robot."""
    server, client = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
    return x509.ExtendedKeyUsage({GATEWAY: [server, client], CONSOLE: [server]}.get(common_name, [client]))


def _builder(
    subject: x509.Name, key: CertificatePublicKeyTypes, start: dt.datetime, end: dt.datetime, *, is_ca: bool
) -> x509.CertificateBuilder:
    usage = x509.KeyUsage(not is_ca, False, False, False, False, is_ca, is_ca, False, False)
    builder = x509.CertificateBuilder().subject_name(subject).public_key(key)
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(start).not_valid_after(end)
    builder = builder.add_extension(x509.BasicConstraints(is_ca, 0 if is_ca else None), critical=True)
    return builder.add_extension(usage, critical=True)


def is_issued(certificate: x509.Certificate, ca: x509.Certificate) -> bool:
    """Return whether this CA signed the certificate."""
    with suppress(ValueError, TypeError, InvalidSignature):
        certificate.verify_directly_issued_by(ca)
        return True
    return False


def is_ca(certificate: x509.Certificate) -> bool:
    """Return whether the certificate may sign others."""
    with suppress(x509.ExtensionNotFound):
        return certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    return False


def parse_hosts(texts: Sequence[str]) -> list[str]:
    """Return host names in lower case and plain IP addresses, each once. Raises ConfigError for any other text."""
    return list(dict.fromkeys(map(_parse_host, texts)))


def _parse_host(text: str) -> str:
    host = text.strip().strip("[]").lower().removesuffix(".")
    address = _address(host)
    if address is not None and not address.is_unspecified and "%" not in host:  # a zone counts on this machine only
        return str(address)
    if _HOST.fullmatch(host):
        return host
    fix = "give what laptops dial, such as robot.local or 192.0.2.7 (no port, no tls/)"
    raise ConfigError(f"{text!r} is neither a host name nor an IP address: {fix}")


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """Return the names and addresses that a gateway's certificate is valid for, in the order they were given."""
    with suppress(x509.ExtensionNotFound):
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        return [str(name.value) for name in names if isinstance(name, x509.DNSName | x509.IPAddress)]
    return []


class Certificate(NamedTuple):
    """What a certificate states. One person may have several, each with a common name of its own."""

    name: str
    """A robot's first host; the CA's, or a laptop's or its person's name. "": none."""
    role: str
    """ca, gateway, operator, observer, button, console; for any other, the common name."""
    common_name: str
    serial: int
    not_before: dt.datetime
    not_after: dt.datetime
    hosts: Sequence[str] = ()
    path: Path = Path()


def describe(certificate: x509.Certificate, path: Path = Path()) -> Certificate:
    """Return what the certificate, which is in the file at `path`, states."""
    oids = (NameOID.COMMON_NAME, NameOID.ORGANIZATIONAL_UNIT_NAME)
    (common, unit), hosts = (_attribute(certificate.subject, each) for each in oids), hosts_of(certificate)
    name, role = next(iter(hosts), unit) if common == GATEWAY else unit, role_of(common)
    if is_ca(certificate):
        name, role, common = common, CA, CA
    span = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return Certificate(name, role, common, certificate.serial_number, *span, tuple(hosts), path)


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
