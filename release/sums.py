"""SHA-256 of all files, and one signature: by ssh-keygen, which every robot has before any of our packages is there.

Ed25519 either way; `openssl` would do as well, but ssh-keygen names what a signature is for (its namespace), and what
key made it, and people know how to keep its keys.
"""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from release.build import run

SUMS = "SHA256SUMS"
SIGNATURE = "SHA256SUMS.sig"
NAMESPACE = "hexapod-gateway-release"


def sums(paths: Iterable[Path]) -> str:
    """As `sha256sum --check` reads them."""
    return "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(paths))


def write_sums(folder: Path, paths: Iterable[Path]) -> Path:
    """SHA256SUMS of these files of the folder."""
    (folder / SUMS).write_text(sums(paths))
    return folder / SUMS


def sign(folder: Path, key: Path) -> Path:
    """SHA256SUMS.sig, in the folder of SHA256SUMS."""
    (folder / SIGNATURE).unlink(missing_ok=True)
    run(["ssh-keygen", "-q", "-Y", "sign", "-f", str(key.absolute()), "-n", NAMESPACE, str((folder / SUMS).absolute())])
    return folder / SIGNATURE
