"""Proofs of the sender of a request for the lease or of a button: signed with a certificate's key.

The certificate has the person's name and role (see `authority`). Zenoh checks the certificate of a link, and messages
carry no identity of their link; so the gateway checks the person's, once for each lease or button.
"""

import base64
import datetime as dt
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa

from gateway.certs import BUTTON, OPERATOR, first_fault
from gateway.certs.authority import Certificate, describe, is_ca, is_issued
from gateway.certs.files import read_key
from gateway.certs.revocation import RevocationList
from schemas import button, lease
from schemas.lease import Proof


class Purpose(NamedTuple):
    """The use of a proof: the roles that may make it, and the text that it signs, from (do, source, nonce)."""

    roles: tuple[str, ...]
    signed: Callable[[str, str, str], bytes]
    own_names: bool = False
    """Whether a person may use several names: `anna/phone`."""


DRIVING: Final = Purpose((OPERATOR,), lease.signed_text)
WATCHING: Final = Purpose((OPERATOR, BUTTON), button.signed_text, own_names=True)
"""An operator may also be a button."""


class ProofChecker:
    """Checks proofs against the CAs of one gateway. Immutable."""

    def __init__(self, cas: Sequence[x509.Certificate], revoked: RevocationList | None = None) -> None:
        self._revoked = revoked
        self._cas = [ca for ca in cas if is_ca(ca)]

    def clock_fault(self, now: dt.datetime) -> str | None:
        """Return a sentence if this robot's clock must be wrong; None: it may be right."""
        made = min((ca.not_valid_before_utc for ca in self._cas), default=now)
        if made <= now:
            return None
        wrong = f"it shows {_minute(now)} UTC, before its CA was made ({_minute(made)})"
        return f"this robot's clock is wrong: {wrong}; until it is set, no certificate can be checked"

    def fault(self, proof: Proof, do: str, source: str, now: dt.datetime, purpose: Purpose = DRIVING) -> str | None:
        """Return why the proof does not show that `source` sent this request; None: it does. Ignores the nonce."""
        if (wrong_clock := self.clock_fault(now)) is not None:
            return wrong_clock
        try:
            certificate = x509.load_pem_x509_certificates(proof.certificate.encode())[0]
            fault = self._certificate_fault(certificate, source, now, purpose)
            if not fault and not _signed(certificate, proof.signature, purpose.signed(do, source, proof.nonce)):
                fault = "proof.signature is not made with the certificate's key, for this do, source and nonce"
        except Exception:  # untrusted bytes: no exception of their parser may end the service
            return "proof.certificate is no X.509 certificate in PEM form that can be read"
        return fault or None

    def _certificate_fault(self, certificate: x509.Certificate, source: str, now: dt.datetime, purpose: Purpose) -> str:
        stated = describe(certificate)
        clock, roles = f"the robot's clock states {_minute(now)}", " or a ".join(purpose.roles)
        valid = (ca for ca in self._cas if ca.not_valid_before_utc <= now <= ca.not_valid_after_utc)
        issued = any(is_issued(certificate, ca) for ca in valid)
        revoked = self._revoked is not None and self._revoked.holds(stated.common_name, stated.serial)
        own = stated.name == source or (purpose.own_names and source.startswith(f"{stated.name}/"))
        what, other = "proof.certificate", "get another from the person with the CA's key"
        return first_fault(
            (not issued, f"{what} is not signed by this gateway's CA"),
            (now < stated.not_before, f"{what} is valid from {_minute(stated.not_before)} UTC; {clock}"),
            (now > stated.not_after, f"{what} expired at {_minute(stated.not_after)} UTC; {clock}"),
            (revoked, f"{what} is revoked ({stated.common_name}); {other}"),
            (stated.role not in purpose.roles, f"{what} is not that of an {roles} of this robot"),
            (not own, f"source is not the person of {what}"),
        )


def holder(proof: Proof) -> Certificate:
    """Return what the certificate in an accepted proof states."""
    return describe(x509.load_pem_x509_certificates(proof.certificate.encode())[0])


def sign(key_file: Path, text: bytes) -> bytes:
    """Sign `text` with a certificate's key, and return the signature. Raises ConfigError."""
    key: Any = read_key(key_file)
    return bytes(key.sign(text, *_scheme(key)))


def _signed(certificate: x509.Certificate, signature: str, text: bytes) -> bool:
    key: Any = certificate.public_key()
    with suppress(ValueError, TypeError, InvalidSignature):
        key.verify(base64.b64decode(signature, validate=True), text, *_scheme(key))
        return True
    return False


def _scheme(key: object) -> tuple[object, ...]:
    """Return what `sign` and `verify` of a key of this kind take after the text. Raises TypeError for other kinds."""
    if isinstance(key, ec.EllipticCurvePrivateKey | ec.EllipticCurvePublicKey):
        return (ec.ECDSA(hashes.SHA256()),)
    if isinstance(key, rsa.RSAPrivateKey | rsa.RSAPublicKey):
        return padding.PKCS1v15(), hashes.SHA256()
    raise TypeError("neither an elliptic-curve nor an RSA key")


def _minute(now: dt.datetime) -> str:
    return f"{now:%Y-%m-%d %H:%M}"


MOST_NONCES: Final = 256
"""The most open nonces: one more replaces the oldest. A flood of challenges hurts only clients that use theirs late."""


class Nonces:
    """Issued nonces that are not used yet. Each is valid once, for a short time."""

    def __init__(self, valid_ns: int) -> None:
        self._valid_ns = valid_ns
        self._until_ns: dict[str, int] = {}

    def issue(self, nonce: str, now_ns: int) -> str:
        """Issue this nonce (128 random bits) and return it."""
        if len(self._until_ns) >= MOST_NONCES:
            del self._until_ns[next(iter(self._until_ns))]
        self._until_ns[nonce] = now_ns + self._valid_ns
        return nonce

    def spend(self, nonce: str, now_ns: int) -> bool:
        """Return whether this nonce is valid, and invalidate it."""
        until_ns = self._until_ns.pop(nonce, None)
        return until_ns is not None and now_ns < until_ns
