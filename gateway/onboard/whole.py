"""Checks whether the installed package is complete, by dpkg's list of its files and checksums.

Imports the standard library alone: it must load if other files of the release are damaged.
"""

import os
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

PACKAGE: Final = "hexapod-gateway"
LIBRARY: Final = Path(f"/usr/lib/{PACKAGE}")
CURRENT: Final = LIBRARY / "current"
SHOWN: Final = 3
"""Most files named in a sentence."""
_LOADED: Final = (".py", ".so")
"""The files that Python loads from the release's folder."""
_DPKG_S: Final = 60


class Whole(NamedTuple):
    """Files that differ from dpkg's list."""

    changed: tuple[str, ...] = ()
    """Missing, or with other content."""
    added: tuple[str, ...] = ()
    """Python would load these, and the package did not install them."""
    closed: tuple[str, ...] = ()
    """Not owned by root, writable by others, or not readable by all. The service does not run as root."""


def version() -> str:
    """Return the installed version; "" if no package is installed."""
    return _dpkg("dpkg-query", "--show", "--showformat=${Version}")


def status() -> str:
    """Return what dpkg is to do with the package, and its state: "install half-configured"; "" without dpkg."""
    return _dpkg("dpkg-query", "--show", "--showformat=${db:Status-Want} ${db:Status-Status}")


def compare() -> Whole:
    """Compare every file of the package with dpkg's list; takes 1 to 2 s."""
    listed = set(_dpkg("dpkg-query", "--listfiles").splitlines())
    verified = [line.split(None, 1)[1] for line in _dpkg("dpkg", "--verify").splitlines() if line]
    release = CURRENT.resolve()
    is_this = str(release).removesuffix(".kept") in listed  # not the previous one
    there = [path for path in _files(release) if is_this and str(path).replace(".kept/", "/", 1) not in listed]
    return Whole(
        changed=tuple(path for path in verified if not path.startswith("c ")),  # a configuration file is its owner's
        added=tuple(sorted(str(path) for path in there if path.suffix in _LOADED)),
        closed=tuple(str(path) for path in _files(release) if not _is_open(path.lstat())),
    )


def how_to_repeat(version: str) -> str:
    """Return the command that installs the package anew."""
    return f"with the package of this release: sudo apt-get install --reinstall ./{PACKAGE}_{version}_ARCH.deb"


def why_nothing_loads() -> str:
    """Return what `check` prints if a damaged or added file prevents loading; "" if none does."""
    found = compare()
    if found.changed:
        return f"not as installed: {', '.join(found.changed[:SHOWN])} → {how_to_repeat(version())}"
    added = " ".join(found.added)  # such as a json.py, which comes before Python's own
    return f"in the release, and not installed with it: {added} → sudo rm {added}" if added else ""


def _dpkg(*command: str) -> str:
    try:
        done = subprocess.run([*command, PACKAGE], capture_output=True, text=True, check=False, timeout=_DPKG_S)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout


def _files(release: Path) -> Iterator[Path]:
    for folder, folders, files in os.walk(release):
        folders[:] = [each for each in folders if each != "__pycache__"]  # postinst compiles
        yield from (Path(folder, file) for file in files)


def _is_open(status: os.stat_result) -> bool:
    return status.st_uid == 0 and not status.st_mode & 0o022 and bool(status.st_mode & stat.S_IROTH)
