"""Whether the installed release is whole: the installer wrote the SHA-256 of each file into the release's `complete`.

Imports the standard library alone: it has to load where other files of the release are damaged.
"""

import hashlib
import os
import shlex
import stat
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, NamedTuple

INSTALLED: Final = Path("/opt/hexapod-gateway/venv")
SHOWN: Final = 3
"""As many files are named in a sentence."""
_MARK: Final = "complete"
_AGAIN: Final = "again"
"""The command line by which the release was installed, as the installer noted it."""
_RUN: Final = (".py", ".pth", ".so")
"""What Python loads by itself from a folder of packages."""
_HEX: Final = 64
_BLOCK: Final = 1 << 20


class Whole(NamedTuple):
    """A release, compared with its list; all paths are relative to it."""

    changed: tuple[str, ...] = ()
    """Missing, or with another content."""
    added: tuple[str, ...] = ()
    """Would be loaded, and was not installed."""
    closed: tuple[str, ...] = ()
    """May be written by others than root, or not be read by all: the service is not root."""


def compare(release: Path) -> Whole:
    """Read every file of a release; some 5 000 with 100 MB, in a second or two."""
    try:
        lines = (release / _MARK).read_text().splitlines()
    except (OSError, ValueError):
        lines = []
    wanted = {line[_HEX + 2 :].removeprefix("./"): line[:_HEX] for line in lines if len(line) > _HEX + 2}
    if not wanted:
        return Whole(changed=(_MARK,))
    # hashlib and reading release the interpreter's lock.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = dict(zip(wanted, pool.map(lambda name: _look(release / name), wanted), strict=True))
    return Whole(
        changed=tuple(name for name, (digest, _) in found.items() if digest != wanted[name]),
        added=tuple(sorted(name for name in _loadable(release) if name not in wanted)),
        closed=tuple(name for name, (_, open_to_all) in found.items() if not open_to_all),
    )


def how_to_repeat(release: Path) -> str:
    """The command that installs a release anew, where this machine still has what it needs."""
    try:
        command = (release / _AGAIN).read_text().strip()
        needed = [Path(each).exists() for each in shlex.split(command) if each.startswith("/")]
    except (OSError, ValueError):  # also of a folder that this user may not enter
        command, needed = "", []
    if needed and all(needed):
        return f"sudo {command}"
    return "install it anew, from the bundle or repository that it came from: sudo deploy/install.sh"


def why_nothing_loads() -> str:
    """What `check` says where a damaged file keeps it from being loaded itself; "": no file is."""
    release = INSTALLED.resolve()
    changed = compare(release).changed
    if not changed:
        return ""
    return f"not as installed in {release}: {', '.join(changed[:SHOWN])} → {how_to_repeat(release)}"


def _look(path: Path) -> tuple[str, bool]:
    """SHA-256 in hex ("" if it cannot be read), and whether only root may change it and everybody read it."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            status = os.fstat(file.fileno())
            while block := file.read(_BLOCK):
                digest.update(block)
    except OSError:
        return "", True
    mode = stat.S_IMODE(status.st_mode)
    return digest.hexdigest(), status.st_uid == 0 and not mode & 0o022 and bool(mode & 0o004)


def _loadable(release: Path) -> Iterator[str]:
    for folder, folders, files in os.walk(release / "lib"):
        folders[:] = [each for each in folders if each != "__pycache__"]  # a look at a module compiles it
        yield from (os.path.relpath(Path(folder, file), release) for file in files if file.endswith(_RUN))
