"""The test's end of the emulated SPI device: start programs on it, see every transfer, cause every fault.

    with SpiTestbed() as bed:
        gateway = bed.spawn(["hexapod-gateway", "run", "--config", "gateway.toml"])
        bed.wait_for_count(6)                            # the six Stops of the start
        bed.fail(errno.EIO)
        ...
        gateway.kill()
        bed.spawn(["hexapod-gateway", "stop-servos"])    # the same device, the next program

Everything in it is one stream in order: when `fail` (or any other fault) returns, it holds for every later transfer,
and all earlier ones are in `transfers`. Waits are for events and end after `timeout_s`; in a coroutine, put them
into `asyncio.to_thread`.
"""

import importlib.util
import json
import os
import socket
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from tests.benchmarks.processes import never_delay
from tests.support.child import Child
from tests.support.waiting import Closing

DEVICE = "/dev/spidev0.0"
SYSTEM_PYTHON = "/usr/bin/python3"  # the one Debian's gi belongs to
PROGRAM = Path(__file__).with_name("spi_testbed.py")
NEEDS = 'import ctypes, gi; gi.require_version("UMockdev", "1.0"); ctypes.CDLL("libumockdev-preload.so.0")'
PACKAGES = "python3-gi gir1.2-umockdev-1.0 umockdev"
REPLY_TIMEOUT_S = 30.0  # a reply takes about a millisecond; 12 ms where the node goes or returns


@cache
def missing_packages() -> str:
    """Return what a test with the emulated device lacks here, in one line; empty when nothing."""
    missing = (
        not Path(SYSTEM_PYTHON).exists()
        or subprocess.run([SYSTEM_PYTHON, "-c", NEEDS], capture_output=True, check=False).returncode
    )
    lacks = [f"Debian packages missing, of: {PACKAGES}"] * bool(missing)
    if importlib.util.find_spec("spidev") is None:
        lacks.append("Python package missing: spidev (hexapod-gateway[spi])")
    return "; ".join(lacks)


@dataclass(frozen=True)
class Transfer:
    """One chip-select cycle that puts bytes on the wire; `errno` is what its call was answered for it, 0 for success.

    A call makes several where chip select is released between its transfers; the first that fails is the last.
    """

    monotonic_ns: int
    """When it begins: when its call arrived, and its place on the wire."""
    data: bytes
    errno: int
    opening: int
    mode: int
    call: int
    """The number of its call: the same for what left together."""
    held: bool
    """Whether it hangs until `release`."""
    speed_hz: int
    bits_per_word: int
    segments: int
    """How many `spi_ioc_transfer` it is made of."""
    pause_us: int
    """The pause that was asked for at its end: Linux makes it while chip select is asserted, and then releases it."""

    @property
    def delivered(self) -> bool:
        return self.errno == 0


@dataclass(frozen=True)
class Setting:
    """One ioctl that sets something up."""

    kind: Literal["mode", "bits", "speed", "lsb_first"]
    value: int
    opening: int
    """The number of the program's opening of the device, from 1."""


Event = Transfer | Setting
KINDS = {kind.__name__: kind for kind in (Transfer, Setting)}


class SpiTestbed(Closing):
    """An emulated `/dev/spidev0.0`, which outlives the programs started on it."""

    def __init__(self) -> None:
        """Start the emulation. Raises RuntimeError with one line where packages are missing."""
        if lack := missing_packages():
            raise RuntimeError(lack)
        self._changed = threading.Condition()
        self._events: list[Event] = []
        self._replies: dict[int, str | None] = {}
        self.environment: dict[str, str] = {}
        """The variables of programs on the device."""
        self._ended = False
        self._requests = 0
        self._children: list[Child] = []
        self._channel, theirs = socket.socketpair()
        with theirs:
            self._emulation = subprocess.Popen(
                [SYSTEM_PYTHON, PROGRAM, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stderr=subprocess.PIPE,
                text=True,
            )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if not self._wait(lambda: bool(self.environment), REPLY_TIMEOUT_S):
            raise RuntimeError(f"the emulated device did not start: {self.close()}")

    def close(self) -> str:
        """Kill what still runs, and end the emulation. Return its standard error."""
        for child in self._children:
            child.close()
        if not self._ended:
            self._channel.shutdown(socket.SHUT_WR)
        try:
            _, said = self._emulation.communicate(timeout=REPLY_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._emulation.kill()
            _, said = self._emulation.communicate()
        self._reader.join(REPLY_TIMEOUT_S)
        self._channel.close()
        return said

    def prefer(self) -> None:
        """Let the emulation come before others, if allowed: it stands for hardware, which no load slows."""
        never_delay(self._emulation.pid)

    def spawn(self, command: Sequence[str], *, env: Mapping[str, str] | None = None) -> Child:
        """Start a program on the device; several may run at once. `env` adds to this process's variables."""
        child = Child(command, {**os.environ, **(env or {}), **self.environment})
        self._children.append(child)
        return child

    @property
    def events(self) -> list[Event]:
        """Return all that has arrived up to now: openings, settings and transfers, in order."""
        if not self._ended:
            self._command("set")
        with self._changed:
            return list(self._events)

    @property
    def transfers(self) -> list[Transfer]:
        """Return the transfers that have arrived up to now, in order, also those that were answered an error."""
        return [event for event in self.events if isinstance(event, Transfer)]

    @property
    def settings(self) -> list[Setting]:
        return [event for event in self.events if isinstance(event, Setting)]

    def wait_for(self, predicate: Callable[[list[Transfer]], bool], timeout_s: float = 20.0) -> list[Transfer]:
        """Wait until `predicate` holds for the transfers, and return them. Raises TimeoutError that lists them."""
        found: list[Transfer] = []

        def holds() -> bool:
            found[:] = [event for event in self._events if isinstance(event, Transfer)]
            return predicate(found)

        if not self._wait(holds, timeout_s):
            arrived = "\n".join(map(str, self._events[-20:])) or "nothing"
            raise TimeoutError(f"waited {timeout_s} s; arrived:\n{arrived}")
        return found

    def wait_for_count(self, count: int, timeout_s: float = 20.0) -> list[Transfer]:
        """Wait until at least `count` transfers have arrived since the start, and return all of them."""
        return self.wait_for(lambda transfers: len(transfers) >= count, timeout_s)

    def wait_for_data(self, data: bytes, *, since: int = 0, timeout_s: float = 20.0) -> Transfer:
        """Wait for a transfer of exactly `data`, delivered, at index `since` or later, and return the first."""

        def found(transfers: list[Transfer]) -> list[Transfer]:
            return [transfer for transfer in transfers[since:] if transfer.data == data and transfer.delivered]

        return found(self.wait_for(lambda transfers: bool(found(transfers)), timeout_s))[0]

    def follow(self, since: int, timeout_s: float) -> list[Event] | None:
        """Return the events from index `since` on; [] if none comes in time; None if there are no more."""
        self._wait(lambda: len(self._events) > since, timeout_s)
        with self._changed:
            return None if self._ended else self._events[since:]

    def fail(self, errno: int, *, after: int = 0) -> None:
        """Let all transfers but the next `after` answer `errno`, until `heal`.

        In a list of transfers, those before it are on the wire, and those behind it are not.
        """
        self._command("set", errno=errno, after=after)

    def fail_by_chance(self, share: float, seed: int) -> None:
        """Let each transfer fail with this probability, until `heal`."""
        self._command("set", share=share, seed=seed)

    def reject_lists(self, errno: int) -> None:
        """Take no lists of transfers, as some kernels: calls of more than one answer `errno`."""
        self._command("set", list_errno=errno)

    def ignore_cs_change(self) -> None:
        """Release no chip select within a call, as some drivers do: a list of transfers is one cycle."""
        self._command("set", ignores_cs_change=True)

    def heal(self) -> None:
        self._command("set", errno=0, share=0.0)

    def block(self) -> None:
        """Answer transfers only by `release` from now on. Each is recorded as it arrives."""
        self._command("set", blocking=True)

    def release(self) -> None:
        """Answer the blocked transfers, and block no more."""
        self._command("release")

    def remove_node(self) -> None:
        """Take the device away: opening answers ENOENT, open descriptors answer ESHUTDOWN for ever."""
        self._command("remove_node")

    def restore_node(self) -> None:
        """Bring the device back, as a new node; ends `remove_node`."""
        self._command("restore_node")

    def answer(self, data: bytes) -> None:
        """Set what later transfers read, without waiting until it is in effect."""
        with self._changed:
            self._send(0, "set", answer=data.hex())

    def _send(self, number: int, name: str, **arguments: object) -> None:
        self._channel.sendall(json.dumps({"id": number, "do": name, **arguments}).encode() + b"\n")

    def _command(self, name: str, **arguments: object) -> None:
        with self._changed:
            self._requests += 1
            number = self._requests
            self._send(number, name, **arguments)
        if not self._wait(lambda: number in self._replies, REPLY_TIMEOUT_S):
            raise RuntimeError(f"the emulated device does not answer to {name}")
        if error := self._replies.pop(number):
            raise RuntimeError(error)

    def _wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        with self._changed:
            self._changed.wait_for(lambda: condition() or self._ended, timeout_s)
            return condition()

    def _read(self) -> None:
        with self._channel.makefile("r", encoding="utf-8") as lines:
            for line in lines:
                self._take(json.loads(line))
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _take(self, record: dict[str, Any]) -> None:
        kind = record.pop("is")
        with self._changed:
            if kind == "ready":
                self.environment = record["environment"]
            elif kind == "reply":
                self._replies[record["id"]] = record["error"]
            else:
                if "data" in record:
                    record["data"] = bytes.fromhex(record["data"])
                self._events.append(KINDS[kind](**record))
            self._changed.notify_all()
