"""Reads certificates and keys, and writes several files together: either all of them appear, complete, or none.

Each error is one sentence with the remedy.
"""

import contextlib
import os
import stat
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa

from gateway.errors import ConfigError
from gateway.files import durable

PUBLIC: Final = (".pem", ".json5", ".crl")
"""Names of the files that everybody may read. All others are secret."""


def read_certificate(path: Path) -> x509.Certificate:
    """Return the first certificate of a PEM file; of a chain, the owner's. Raises ConfigError."""
    return read_certificates(path)[0]


def read_certificates(path: Path) -> list[x509.Certificate]:
    """Return all certificates of a PEM file, at least one. Raises ConfigError."""
    data = read_file(path, "certificate")
    try:
        found = x509.load_pem_x509_certificates(data)
        for each in found:
            _ = each.subject, each.issuer, each.extensions  # parsed at first access
    except Exception as error:  # of the parser, which documents none
        raise ConfigError(f"{path} holds no certificate in PEM form: restore it, or issue a new one") from error
    return found


def read_key(path: Path) -> ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey:
    """Return the unencrypted elliptic-curve or RSA key of a PEM file. Raises ConfigError."""
    try:
        key = serialization.load_pem_private_key(read_file(path, "key"), password=None)
    except (ValueError, TypeError) as error:  # TypeError: it is encrypted
        raise ConfigError(f"{path} holds no unencrypted key in PEM form: restore it from a copy") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey):
        raise ConfigError(f"{path} is neither an elliptic-curve nor an RSA key: restore it from a copy")
    return key


def read_file(path: Path, what: str) -> bytes:
    """Return the content of a regular file. Raises ConfigError, which calls the file `what`."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # a FIFO would block for ever
            raise ConfigError(f"{path} is not a file: the {what} should be there")
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"cannot read the {what} {path}: {error.strerror}; check the path and its owner") from error


def mode_of(path: Path) -> int:
    """Return the mode of a file by its name."""
    return 0o644 if path.suffix in PUBLIC else 0o600


def publish(files: Mapping[Path, bytes]) -> None:
    """Write new files in order. If one exists or cannot be written, remove the others and raise ConfigError."""
    made = list[Path]()
    try:
        for path, data in files.items():
            with _explained(path):
                for parent in reversed([each for each in (path.parent, *path.parent.parents) if not each.exists()]):
                    parent.mkdir(mode=0o700)
                    made.append(parent)
                durable.create(path, data, mode_of(path), prepare=partial(_check_mode, path))
                made.append(path)
        for directory in {path.parent for path in files}:
            with _explained(directory):
                durable.sync(directory)
    except BaseException:
        for each in reversed(made):
            with contextlib.suppress(OSError):  # must not hide the error that led here
                each.rmdir() if each.is_dir() else each.unlink()
        raise


def replace(path: Path, data: bytes) -> None:
    """Replace the file at `path` atomically. Raises ConfigError if it cannot be written."""
    with _explained(path):
        durable.write_with_mode(path, data, mode_of(path), prepare=partial(_check_mode, path))


def _check_mode(path: Path, descriptor: int) -> None:
    if os.fstat(descriptor).st_mode & 0o777 != mode_of(path):
        raise ConfigError(f"{path.parent} cannot keep a file private (FAT?): choose a directory on a Linux file system")


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except FileExistsError as error:
        raise ConfigError(f"{path} exists and is never overwritten: choose another name, or move it away") from error
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}; is the directory yours?") from error
