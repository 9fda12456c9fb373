"""Reads the kernel's table of mounts: whether a boot empties a folder."""

from pathlib import Path
from typing import Final

FORGETS: Final = frozenset({"overlay", "tmpfs", "ramfs"})
"""File systems that are empty, or as before, after a boot."""
_MOUNTS: Final = Path("/proc/self/mountinfo")


def mount_of(path: Path, mounts: str | None = None) -> tuple[str, str]:
    """Return the mount point and the kind of the file system that holds an absolute `path`.

    `mounts` replaces /proc/self/mountinfo. Paths are compared, since a bind mount has the same device as its parent.
    """
    lines = (line.split() for line in (_MOUNTS.read_text() if mounts is None else mounts).splitlines())
    found = [(words[4].replace("\\040", " "), words[words.index("-") + 1]) for words in lines]
    # Of two at one place, the later one hides the earlier one. The root of a chroot need not be a mount point.
    over = [mount for mount in [("/", "unknown"), *found] if path.is_relative_to(mount[0])]
    return max(reversed(over), key=lambda each: len(each[0]))


def forgets(folder: Path) -> str:
    """Return the kind of the folder's file system if a boot empties it, else "" (also if the kind is unknown)."""
    try:
        kind = mount_of(folder.resolve())[1]
    except (OSError, ValueError):
        return ""
    return kind if kind in FORGETS else ""
