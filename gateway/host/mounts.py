"""Whether what is written into a folder is there after the next boot, by the kernel's list of mounts."""

from pathlib import Path
from typing import Final

FORGETS: Final = frozenset({"overlay", "tmpfs", "ramfs"})
"""File systems that are empty, or as before, after a boot."""
_MOUNTS: Final = Path("/proc/self/mountinfo")


def mount_of(path: Path, mounts: str | None = None) -> tuple[str, str]:
    """Where the path's file system is mounted, and of which kind it is.

    A bind mount is on the same device as what is above it, so the paths are compared.
    """
    lines = (line.split() for line in (_MOUNTS.read_text() if mounts is None else mounts).splitlines())
    found = [(words[4].replace("\\040", " "), words[words.index("-") + 1]) for words in lines]
    # Of two at one place, the later one hides the earlier one.
    return max(reversed(found), key=lambda each: len(each[0]) if path.is_relative_to(each[0]) else -1)


def forgets(folder: Path) -> str:
    """The kind of a file system that a boot empties; "" if the folder is on another one, or nobody can tell."""
    try:
        kind = mount_of(folder.resolve())[1]
    except (OSError, ValueError):
        return ""
    return kind if kind in FORGETS else ""
