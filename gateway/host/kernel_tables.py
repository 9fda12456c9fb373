"""Reads the kernel's tables: whether a boot empties a folder, and which sockets of this machine listen on a port."""

import ipaddress
import socket
import sys
from collections.abc import Iterator
from contextlib import suppress
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


_LISTENS: Final = {"0A", "07"}  # TCP_LISTEN; a UDP socket that is bound


def listening(port: int, kind: socket.SocketKind) -> Iterator[tuple[str, int]]:
    """Yield the address and the user id of each socket of this machine that listens on `port`."""
    for file in ("tcp", "tcp6") if kind is socket.SOCK_STREAM else ("udp", "udp6"):
        with suppress(OSError):
            for line in Path("/proc/net", file).read_text().splitlines()[1:]:
                _, local, _, state, _, _, _, uid, *_ = line.split()
                address, _, number = local.rpartition(":")
                if state in _LISTENS and int(number, 16) == port:
                    yield _address(address), int(uid)


def _address(shown: str) -> str:
    """Convert an address from the kernel's form: words of 32 bits in hex, in this machine's byte order."""
    words = [int(shown[place : place + 8], 16).to_bytes(4, sys.byteorder) for place in range(0, len(shown), 8)]
    return str(ipaddress.ip_address(b"".join(words)))
