"""Who has a port or a device open, by the kernel's tables in /proc. Root sees all processes, another user its own."""

import ipaddress
import os
import re
import socket
from collections.abc import Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

from gateway.zenoh.endpoints import host_and_port

_PROC: Final = Path("/proc")
_DATAGRAMS: Final = ("udp", "quic")
_OPEN: Final = {"tcp": "0A", "udp": "07"}
"""States of sockets that listen, in /proc/net/tcp and udp."""
_INODE: Final = 9
"""The inode's column there."""
_MOST: Final = 60
"""The most characters of a command in a sentence."""


class Holder(NamedTuple):
    """A process that has it open."""

    pid: int
    command: str
    unit: str
    """Its systemd service; "" if a person has started it."""

    def __str__(self) -> str:
        return f"{self.command} (process {self.pid}{self.unit and f', {self.unit}'})"

    @property
    def end(self) -> str:
        """The command that ends it."""
        return f"sudo systemctl stop {self.unit}" if self.unit else f"sudo kill {self.pid}"


class OpenFiles:
    """The open files of all processes, read at the first question. Links are read, which waits for no disk."""

    @cached_property
    def _pids(self) -> dict[str, set[int]]:
        found: dict[str, set[int]] = {}
        for process in _PROC.glob("[0-9]*"):
            with suppress(OSError):  # it has ended, or is another user's
                for name in os.listdir(process / "fd"):
                    with suppress(OSError):
                        found.setdefault(os.readlink(process / "fd" / name), set()).add(int(process.name))
        return found

    def look(self) -> None:
        """Read now, with root's rights, for questions without them."""
        _ = self._pids

    def holders(self, path: str) -> list[Holder]:
        """Return who has this file open, also by its path in a container."""
        return self._described(*(each for each in self._pids if each.endswith(os.path.realpath(path))))

    def listeners(self, endpoint: str) -> list[Holder]:
        """Return who listens on this port of `tcp/127.0.0.1:7447`, on the same or on all addresses."""
        host, port = host_and_port(endpoint)
        kind = "udp" if endpoint.startswith(_DATAGRAMS) else "tcp"
        wanted = set()
        with suppress(OSError, ValueError):
            wanted = {ipaddress.ip_address(address[0]) for *_, address in socket.getaddrinfo(host, int(port))}
        sockets = [
            f"socket:[{inode}]"
            for address, at, inode in _sockets(kind)
            if str(at) == port
            and (address.is_unspecified or any(each in (address, _ALL[each.version]) for each in wanted))
        ]
        return self._described(*sockets)

    def _described(self, *links: str) -> list[Holder]:
        pids = sorted({pid for link in links for pid in self._pids.get(link, ())} - {os.getpid()})
        return list(map(_describe, pids))


_ALL: Final = {version: ipaddress.ip_address(text) for version, text in ((4, "0.0.0.0"), (6, "::"))}  # noqa: S104


def _sockets(kind: str) -> Iterator[tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, int, int]]:
    """Yield address, port and inode of each open socket of `tcp` or `udp`."""
    for name in (kind, f"{kind}6"):
        with suppress(OSError):
            for columns in map(str.split, (_PROC / "net" / name).read_text().splitlines()[1:]):
                if columns[3] == _OPEN[kind]:
                    address, _, port = columns[1].partition(":")
                    words = (bytes.fromhex(each)[::-1] for each in re.findall("." * 8, address))
                    yield ipaddress.ip_address(b"".join(words)), int(port, 16), int(columns[_INODE])


def _describe(pid: int) -> Holder:
    command, unit = "a program", ""
    with suppress(OSError):
        words = (_PROC / str(pid) / "cmdline").read_bytes().decode(errors="replace").split("\0")
        command = " ".join(words).strip()[:_MOST] or command
        group = (_PROC / str(pid) / "cgroup").read_text().strip()
        unit = next(iter(re.findall(r"/system\.slice/([^/]+\.service)$", group)), "")
    return Holder(pid, command, unit)
