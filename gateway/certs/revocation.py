"""The list of revoked certificates: an X.509 CRL, signed by the CA, with a number that grows.

`openssl crl -in revoked.crl -text` shows it. A CRL identifies certificates by serial number, Zenoh's rules by common
name, so each entry has its certificate's common name and holder in a private extension, which other readers ignore.

No decision depends on the clock: a list does not expire, and a robot whose clock is in 1970 accepts it.
"""

import datetime as dt
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization

from gateway.certs.authority import KeyPair
from gateway.errors import ConfigError
from gateway.files import durable

REVOCATION_FILE: Final = "revoked.crl"
MAX_LIST_BYTES: Final = 1_000_000
"""The largest list that is read. One entry takes some 125 bytes."""

_HOLDER: Final = x509.ObjectIdentifier("2.25.304287190233465927514019364182720945113")
"""`operator-07/alice` as UTF8String. The identifier is made from a UUID (ITU-T X.667), which needs no registration."""
_HOLDER_TEXT: Final = re.compile(r"[A-Za-z0-9._-]{1,63}/[A-Za-z0-9_-]{0,63}")
"""At most 127 characters: DER then has a length of one byte."""


class ForeignListError(ConfigError):
    """None of the robot's CAs has signed the list."""


class Revoked(NamedTuple):
    """One revoked certificate."""

    common_name: str
    name: str
    """The person or laptop."""
    serial: int
    since: dt.datetime


class RevocationList(NamedTuple):
    """A list whose signature was checked, or that was just signed."""

    number: int
    date: dt.datetime
    """When it was signed, by the clock of the machine with the CA."""
    entries: tuple[Revoked, ...]
    pem: bytes

    @property
    def common_names(self) -> frozenset[str]:
        """The common names that no rule may list."""
        return frozenset(entry.common_name for entry in self.entries)

    def holds(self, common_name: str, serial: int) -> bool:
        """Return whether a certificate with this common name, or this serial number, is revoked."""
        return any(common_name == entry.common_name or serial == entry.serial for entry in self.entries)


def sign(ca: KeyPair, number: int, entries: Iterable[Revoked], now: dt.datetime) -> RevocationList:
    """Return a signed list of these certificates. Raises ConfigError if a name does not fit an entry."""
    kept, name = tuple(entries), ca.certificate.subject
    end = ca.certificate.not_valid_after_utc
    builder = x509.CertificateRevocationListBuilder().issuer_name(name).last_update(now).next_update(end)
    authority = x509.AuthorityKeyIdentifier.from_issuer_public_key(ca.key.public_key())
    builder = builder.add_extension(x509.CRLNumber(number), critical=False).add_extension(authority, critical=False)
    for each in kept:
        holder = x509.UnrecognizedExtension(_HOLDER, _encoded(each))
        entry = x509.RevokedCertificateBuilder().serial_number(each.serial).revocation_date(each.since)
        builder = builder.add_revoked_certificate(entry.add_extension(holder, critical=False).build())
    pem = builder.sign(ca.key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
    return RevocationList(number, now.replace(microsecond=0), kept, pem)


def parse(data: bytes, cas: Sequence[x509.Certificate]) -> RevocationList:
    """Return the list in PEM `data`, signed by one of these CAs. Raises ConfigError, or its ForeignListError."""
    try:
        found = x509.load_pem_x509_crl(data)
        number = found.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number
        entries = tuple(map(_entry, found))
        signed = any(_signed_by(found, ca) for ca in cas)
    except Exception as error:  # untrusted bytes: no exception of their parser may end the service
        raise ConfigError("this is no list of `hexapod-gateway certs revoke`, or it was cut off") from error
    if not signed:
        raise ForeignListError("the list is not signed by a CA of this robot: is it another robot's?")
    return RevocationList(number, found.last_update_utc, entries, data)


def read(path: Path, cas: Sequence[x509.Certificate]) -> RevocationList | None:
    """Return the list at `path`; None: there is no file. Raises as `parse` does, with the file's name."""
    try:
        data = durable.read(path, MAX_LIST_BYTES)
        return None if data is None else parse(data, cas)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be read as a list of revoked certificates: {error}") from error
    except ConfigError as error:
        raise type(error)(f"{path}: {error}") from error


def why_not_newer(found: RevocationList, known: RevocationList | None) -> str | None:
    """Return why `found` must not replace `known`; None: it may."""
    if known is None or found.number > known.number:
        return None
    return f"its number is {found.number}, and number {known.number} is in force: sign a newer one (certs revoke)"


def _entry(found: x509.RevokedCertificate) -> Revoked:
    extension: Any = found.extensions.get_extension_for_oid(_HOLDER).value
    common_name, _, name = extension.value[2:].decode().partition("/")
    entry = Revoked(common_name, name, found.serial_number, found.revocation_date_utc)
    if _encoded(entry) != extension.value:
        raise ValueError("an entry names no common name")
    return entry


def _encoded(entry: Revoked) -> bytes:
    text = f"{entry.common_name}/{entry.name}"
    if _HOLDER_TEXT.fullmatch(text) is None:
        raise ConfigError(f"{entry.common_name} of {entry.name} cannot stand in a list of revoked certificates")
    return bytes([0x0C, len(text)]) + text.encode()  # UTF8String


def _signed_by(found: x509.CertificateRevocationList, ca: x509.Certificate) -> bool:
    key: Any = ca.public_key()
    return found.issuer == ca.subject and found.is_signature_valid(key)
