"""X.509 without files: a private CA, the gateway's and laptops' certificates, and reading them back.

Zenoh's access control identifies a laptop by the first common name of its certificate, its own (names.py). The
laptop's name, or its person's, is in the organizational unit.
"""

import datetime as dt
import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import CertificatePublicKeyTypes
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gateway.certs import CA_DAYS, CONSOLE_DAYS
from gateway.errors import ConfigError

GATEWAY = "gateway"
CA = "ca"
CONSOLE = "console"

# A robot without a network and a battery-backed clock starts with the time of its last shutdown, or of its image, when
# a certificate of today is not valid yet. So all certificates start a year early.
BACKDATE = dt.timedelta(days=365)

_ORGANIZATION = "hexapod-gateway"
_LABEL = re.compile(r"[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?")


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


def make_ca(now: dt.datetime) -> KeyPair:
    """A CA for leaf certificates only; its name has a random part, so that two CAs are never confused."""
    return _make_ca(now, CA, [])


def make_web_ca(hosts: Sequence[str], now: dt.datetime) -> KeyPair:
    """A CA for browsers, valid only for these hosts as servers: with its key nobody can pose as another site."""
    names = [_general_name(host) for host in hosts]
    networks = [ipaddress.ip_network(name.value) for name in names if isinstance(name, x509.IPAddress)]
    # A kind of name without an entry is not constrained, so each gets an unused one.
    permitted: list[x509.GeneralName] = [
        *([name for name in names if isinstance(name, x509.DNSName)] or [x509.DNSName("invalid")]),
        *map(x509.IPAddress, networks or [ipaddress.ip_network("255.255.255.255")]),
    ]
    constraints = x509.NameConstraints(permitted_subtrees=permitted, excluded_subtrees=None)
    usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH])
    return _make_ca(now, CONSOLE, [(constraints, True), (usage, False)])


def permits(ca: x509.Certificate, hosts: Sequence[str]) -> bool:
    """Whether a CA of `make_web_ca` is valid for these hosts, or unconstrained."""
    try:
        constraints = ca.extensions.get_extension_for_class(x509.NameConstraints).value
    except x509.ExtensionNotFound:
        return True
    known = {str(name.value).partition("/")[0] for name in constraints.permitted_subtrees or ()}
    return known.issuperset(hosts)


def _make_ca(now: dt.datetime, unit: str, more: Sequence[tuple[x509.ExtensionType, bool]]) -> KeyPair:
    """`more`: extensions, and whether each is critical."""
    key = ec.generate_private_key(ec.SECP256R1())
    serial = x509.random_serial_number()
    subject = _name(f"{_ORGANIZATION} CA {serial:040x}"[:28], unit)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(serial)
        .not_valid_before(now - BACKDATE)
        .not_valid_after(now + dt.timedelta(days=CA_DAYS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(ca=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    for extension, critical in more:
        builder = builder.add_extension(extension, critical=critical)
    return KeyPair(builder.sign(key, hashes.SHA256()), key)


def make_gateway(ca: KeyPair, hosts: Sequence[str], days: int, now: dt.datetime) -> KeyPair:
    """The gateway's certificate: a server for `hosts`, and a client where it dials another Zenoh program."""
    usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    return _make_leaf(ca, _name(GATEWAY, GATEWAY), usages, hosts, days, now)


def make_laptop(ca: KeyPair, name: str, common_name: str, days: int, now: dt.datetime) -> KeyPair:
    """A laptop's certificate: a client only, so that no laptop can pose as the robot."""
    return _make_leaf(ca, _name(common_name, name), [ExtendedKeyUsageOID.CLIENT_AUTH], (), days, now)


def make_console(ca: KeyPair, name: str, hosts: Sequence[str], days: int, now: dt.datetime) -> KeyPair:
    """A web console's certificate: a server for `hosts` only, without a role in Zenoh's access control."""
    return _make_leaf(ca, _name(CONSOLE, name), [ExtendedKeyUsageOID.SERVER_AUTH], hosts, days, now)


def _make_leaf(
    ca: KeyPair,
    subject: x509.Name,
    usages: Sequence[x509.ObjectIdentifier],
    hosts: Sequence[str],
    days: int,
    now: dt.datetime,
) -> KeyPair:
    key = ec.generate_private_key(ec.SECP256R1())
    return KeyPair(_sign(ca, subject, key.public_key(), x509.ExtendedKeyUsage(usages), hosts, days, now), key)


def renew(
    ca: KeyPair, old: x509.Certificate, days: int, now: dt.datetime, hosts: Sequence[str] = ()
) -> x509.Certificate:
    """`old` with a new serial number and expiry, same holder and key, valid as a server for `hosts`."""
    usage = next((item.value for item in old.extensions if isinstance(item.value, x509.ExtendedKeyUsage)), None)
    return _sign(ca, old.subject, old.public_key(), usage, hosts, days, now)


def is_issued(certificate: x509.Certificate, ca: x509.Certificate) -> bool:
    """Whether this CA signed the certificate."""
    try:
        certificate.verify_directly_issued_by(ca)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True


def is_ca(certificate: x509.Certificate) -> bool:
    """Whether the certificate may sign others."""
    try:
        return certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except x509.ExtensionNotFound:
        return False


def parse_host(text: str) -> str:
    """`text` as a host name in lower case or a plain IP address; raises ConfigError for anything else."""
    host = text.strip().strip("[]").lower()
    address = _address(host)
    if (
        address is not None and not address.is_unspecified and "%" not in host
    ):  # a zone has a meaning on this machine only
        return str(address)
    labels = host.removesuffix(".").split(".")
    # A last label of digits only is a mistyped address (192.0.2.999), never a host name.
    if (
        address is None
        and all(_LABEL.fullmatch(part) for part in labels)
        and not labels[-1].isdigit()
        and len(host) < 254
    ):
        return host.removesuffix(".")
    raise ConfigError(
        f"{text!r} is neither a host name nor an IP address: give what laptops dial, such as robot.local or 192.0.2.7 "
        "(no port, no tls/)"
    )


def hosts_of(certificate: x509.Certificate) -> list[str]:
    """The names and addresses that a gateway's certificate is good for, in the order they were given."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in names if isinstance(name, x509.DNSName | x509.IPAddress)]


def common_name_and_name(certificate: x509.Certificate) -> tuple[str, str]:
    """The holder: ("ca", its name), ("gateway", its first host), or a laptop's (common name, name); "" if absent."""
    common = _attribute(certificate.subject, NameOID.COMMON_NAME)
    unit = _attribute(certificate.subject, NameOID.ORGANIZATIONAL_UNIT_NAME)
    if is_ca(certificate):
        return CA, common
    if common == GATEWAY:
        return GATEWAY, next(iter(hosts_of(certificate)), unit)
    return common, unit


def _sign(
    ca: KeyPair,
    subject: x509.Name,
    key: CertificatePublicKeyTypes,
    usage: x509.ExtendedKeyUsage | None,
    hosts: Sequence[str],
    days: int,
    now: dt.datetime,
) -> x509.Certificate:
    issuer = ca.certificate
    if _attribute(subject, NameOID.COMMON_NAME) == CONSOLE:
        days = min(days, CONSOLE_DAYS)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer.subject)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(max(now - BACKDATE, issuer.not_valid_before_utc))
        # A leaf that outlives its CA would be rejected while `certs list` still shows it as good.
        .not_valid_after(min(now + dt.timedelta(days=days), issuer.not_valid_after_utc))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(ca=False), critical=True)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(ca.key.public_key()), critical=False)
    )
    names = x509.SubjectAlternativeName([_general_name(host) for host in hosts]) if hosts else None
    for extension in (usage, names):
        if extension is not None:
            builder = builder.add_extension(extension, critical=False)
    return builder.sign(ca.key, hashes.SHA256())


def _name(common_name: str, unit: str) -> x509.Name:
    return x509.Name(
        [
            x509.NameAttribute(NameOID.COMMON_NAME, common_name),
            x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, unit),
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, _ORGANIZATION),
        ]
    )


def _key_usage(*, ca: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not ca,
        key_cert_sign=ca,
        crl_sign=ca,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _attribute(name: x509.Name, oid: x509.ObjectIdentifier) -> str:
    return next((str(attribute.value) for attribute in name.get_attributes_for_oid(oid)), "")


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _general_name(host: str) -> x509.GeneralName:
    address = _address(host)
    return x509.DNSName(host) if address is None else x509.IPAddress(address)
