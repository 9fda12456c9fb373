"""Who asks for the lease, or is a button: the person of the own certificate, and a nonce signed with its key.

`cryptography` is loaded only when a lease is asked for: it takes long, and no emergency stop should wait for it.
"""

import base64
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import zenoh

from gateway import certs
from gateway.errors import ConfigError
from gateway.zenoh_config import get

if TYPE_CHECKING:
    from cryptography import x509

_TLS: Final = "transport/link/tls"


@dataclass(frozen=True)
class Identity:
    """A client's certificate and key, as its Zenoh file names them."""

    certificate: Path
    key: Path

    @classmethod
    def of(cls, config: zenoh.Config) -> "Identity | None":
        """Of a configuration whose paths are absolute; None where it names none."""
        certificate, key = get(config, f"{_TLS}/connect_certificate"), get(config, f"{_TLS}/connect_private_key")
        if isinstance(certificate, str) and isinstance(key, str):
            return cls(Path(certificate), Path(key))
        return None

    def person(self) -> str:
        """Whose certificate it is: its organizational unit. Raises ConfigError."""
        from cryptography.x509.oid import NameOID

        units = self._read().subject.get_attributes_for_oid(NameOID.ORGANIZATIONAL_UNIT_NAME)
        if not units:
            raise ConfigError(f"{self.certificate} names no person: get one from `hexapod-gateway certs issue NAME`")
        return str(units[0].value)

    def prove(
        self, do: str, source: str, nonce: str, text: Callable[[str, str, str], bytes] | None = None
    ) -> dict[str, str]:
        """The proof that this person wants this now. `text` is what is signed, by default a lease's.

        Raises ConfigError.
        """
        from cryptography.hazmat.primitives import serialization

        from schemas.lease import signed_text

        signature = _sign(self.key, (text or signed_text)(do, source, nonce))
        pem = self._read().public_bytes(serialization.Encoding.PEM).decode()
        return {"nonce": nonce, "certificate": pem, "signature": base64.b64encode(signature).decode()}

    def _read(self) -> "x509.Certificate":
        return certs.read_certificate(self.certificate)


def _sign(file: Path, data: bytes) -> bytes:
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa

    try:
        key: Any = serialization.load_pem_private_key(certs.read_file(file, "key"), password=None)
    except (ValueError, TypeError) as error:  # TypeError: it is encrypted
        raise ConfigError(f"{file} holds no unencrypted key in PEM form: restore it from a copy") from error
    if isinstance(key, ec.EllipticCurvePrivateKey):
        return key.sign(data, ec.ECDSA(hashes.SHA256()))
    if isinstance(key, rsa.RSAPrivateKey):
        return key.sign(data, padding.PKCS1v15(), hashes.SHA256())
    raise ConfigError(f"{file} is neither an elliptic-curve nor an RSA key: get one from `hexapod-gateway certs issue`")
