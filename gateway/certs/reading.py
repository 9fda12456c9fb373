"""Reads certificates and keys from files. Each error is one sentence that says what to do."""

import stat
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from gateway.errors import ConfigError


def read_certificate(path: Path) -> x509.Certificate:
    """The first certificate of a PEM file; in a chain that is the owner's."""
    return read_certificates(path)[0]


def read_certificates(path: Path) -> list[x509.Certificate]:
    """All certificates of a PEM file, at least one; ConfigError if it is missing, unreadable or none."""
    data = read_file(path, "certificate")
    try:
        return x509.load_pem_x509_certificates(data)
    except ValueError as error:
        raise ConfigError(
            f"{path} holds no certificate in PEM form: restore it from a copy, or issue a new one"
        ) from error


def read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """A private key that is not encrypted; ConfigError if the file is missing, unreadable or no such key."""
    data = read_file(path, "key")
    try:
        key = serialization.load_pem_private_key(data, password=None)
    except (ValueError, TypeError) as error:  # TypeError: it is encrypted
        raise ConfigError(f"{path} holds no unencrypted key in PEM form: restore it from a copy") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ConfigError(f"{path} is not the elliptic-curve key that `certs init` makes: restore it from a copy")
    return key


def read_file(path: Path, what: str) -> bytes:
    """The content of a regular file; ConfigError otherwise. `what` says what it should have been."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a FIFO would block for ever
            raise ConfigError(f"{path} is not a file: the {what} should be there")
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(
            f"cannot read the {what} {path}: {error.strerror}; check the path and who owns the file"
        ) from error
