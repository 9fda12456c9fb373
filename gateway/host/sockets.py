"""Which sockets of this machine listen on a port, by the kernel's own tables."""

import ipaddress
import socket
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

_LISTENS: Final = {"0A", "07"}  # TCP_LISTEN; a UDP socket that is bound


def listening(port: int, kind: socket.SocketKind) -> Iterator[tuple[str, int]]:
    """Address and user (a number) of each socket of this machine that listens on a port."""
    for file in ("tcp", "tcp6") if kind is socket.SOCK_STREAM else ("udp", "udp6"):
        with suppress(OSError):
            for line in Path("/proc/net", file).read_text().splitlines()[1:]:
                _, local, _, state, _, _, _, uid, *_ = line.split()
                address, _, number = local.rpartition(":")
                if state in _LISTENS and int(number, 16) == port:
                    yield _address(address), int(uid)


def _address(shown: str) -> str:
    """As the kernel shows it: words of 32 bits in hex, each in this machine's byte order."""
    words = [int(shown[place : place + 8], 16).to_bytes(4, sys.byteorder) for place in range(0, len(shown), 8)]
    return str(ipaddress.ip_address(b"".join(words)))
