"""One signed file with all that a robot without a network needs: what `deploy/install.sh --bundle` verifies."""

import os
from pathlib import Path

from release.build import plain_tar, run
from release.sums import PUBLIC_KEY, SIGNATURE, SUMS, public_key, sign, write_sums

SYSTEM_PYTHON = "/usr/bin/python3"
"""A robot's service runs the system's own."""


def wheels(folder: Path, own: Path, when: int, processor: str = "", python: str = "") -> Path:
    """What `make wheels` makes, with this wheel as ours: for this machine and its Python, or for another's."""
    environment = {**os.environ, "SOURCE_DATE_EPOCH": str(when), "OWN_WHEEL": str(own.absolute())}
    whom = [processor, python or "3.11"] if processor else []
    run(["deploy/wheels.sh", SYSTEM_PYTHON, str(folder.absolute()), *whom], environment)
    return folder


def bundle(to: Path, filled: Path, released: str, when: int, key: Path) -> Path:
    """A tar of what `wheels` has filled, its sums, their signature, and the public key."""
    for name in (SUMS, SIGNATURE, PUBLIC_KEY):
        (filled / name).unlink(missing_ok=True)
    (filled / PUBLIC_KEY).write_bytes(public_key(key))
    write_sums(filled, list(filled.iterdir()))
    sign(filled, key)
    # After its wheels: which Python and processor they are for.
    tags = next(filled.glob("lz4-*.whl")).stem.split("-")
    kind = f"{tags[2]}-{'aarch64' if 'aarch64' in tags[-1] else 'x86_64'}"
    path = to / f"hexapod-gateway-{released}-{kind}.bundle"
    path.write_bytes(plain_tar({each.name: each.read_bytes() for each in filled.iterdir()}, when))
    return path
