#!/usr/bin/python3
"""An emulated `/dev/spidev0.0` (umockdev) for unmodified programs; runs under the system's Python, which has gi.

The test kit starts `spi_testbed.py FD` with its end of a socket; `tests/hil/bed.py` is the other end. On it, JSON
lines both ways. Out: first `ready` with the environment for children, then every setting and transfer as it arrives
and before it is answered, and one `reply` per request. In: `{"id": 1, "do": "set", …}`.

The answers follow Linux's drivers/spi/spidev.c, spi.c and spi-bcm2835.c (Raspberry Pi 4): 8 bits only, no lsb-first,
all openings share one mode, speed and number of bits; mode and bits outlive the program that set them, and the speed
falls back at the last close. An open descriptor whose device has gone answers ESHUTDOWN for ever. A message holds 4096
bytes, of which each transfer takes a multiple of 128. A transfer's pause is made while chip select is asserted; behind
those with `cs_change` it is then released for 10 µs, whatever pause was asked for. Each such cycle, its pause included,
is an event of its own, with the time at which it begins. A call lasts as long as the wire needs, and no other call
comes into it. MISO reads the bytes of the last `answer`, from the first on with each message, and zeros behind them:
what a controller sends was made ready before.
"""

import errno
import json
import os
import random
import shutil
import signal
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

NODE = "spidev0.0"
PRELOAD = "libumockdev-preload.so.0"
DEFAULT_SPEED_HZ = 125_000_000  # what the Pi's device tree gives spidev0.0
SLOWEST_HZ = 500_000_000 // 65536  # spi-bcm2835 divides its 500 MHz by no more, however slow a clock is asked for
BUFSIZ = 4096  # spidev's module parameter, its default
ALIGNED = 128  # ARCH_DMA_MINALIGN: what a transfer takes of that is a multiple of it
CS_CHANGE_NS = 10_000  # for how long Linux releases chip select between two transfers, after their pause
SPIN_NS = 150_000  # a sleep may end later than asked by as much
# From linux/spi/spi.h: CPHA, CPOL, CS_HIGH, 3WIRE, NO_CS: all that spi-bcm2835 supports.
SUPPORTED_MODE_BITS = 0x01 | 0x02 | 0x04 | 0x10 | 0x40
# From linux/spi/spidev.h: `_IOC(direction, 'k', number, size)`.
IOC_MAGIC, IOC_READ = ord("k"), 2
NR_MESSAGE, NR_MODE, NR_LSB_FIRST, NR_BITS, NR_SPEED, NR_MODE32 = 0, 1, 2, 3, 4, 5
SETTINGS = {NR_MODE: "mode", NR_LSB_FIRST: "lsb_first", NR_BITS: "bits", NR_SPEED: "speed", NR_MODE32: "mode"}
# struct spi_ioc_transfer: tx_buf, rx_buf, len, speed_hz, delay_usecs, bits_per_word, cs_change, nbits and padding.
SEGMENT = struct.Struct("=QQIIHBBBBBB")


class Segment(NamedTuple):
    """What counts of it. A speed and bits of 0 are the device's own."""

    data: bytes
    speed_hz: int
    bits: int
    delay_us: int
    cs_change: int


Emit = Callable[[dict[str, object]], None]


class Testbed:
    """The emulated node, its bus and their faults.

    The control socket may ask for its methods without an underscore. umockdev calls the handlers on its own thread,
    commands come on the main one.
    """

    def __init__(self, emit: Emit) -> None:
        import gi  # noqa: PLC0415

        gi.require_version("UMockdev", "1.0")
        from gi.repository import UMockdev  # noqa: PLC0415

        self._emit = emit
        self._lock = threading.Lock()
        self._clients: dict[Any, int] = {}  # every one that ever connected, numbered: umockdev wants them kept
        self._openings: dict[Any, int] = {}
        self._gone_before = 0  # clients up to this number hold a descriptor of a device that was removed
        self._mode, self._bits, self._speed_hz = 0, 8, DEFAULT_SPEED_HZ
        self._faults: dict[str, Any] = {
            **{"errno": 0, "after": 0, "share": 0.0, "list_errno": 0},
            **{"ignores_cs_change": False, "blocking": False, "answer": ""},
        }
        self._chance = random.Random()  # noqa: S311  (faults, no secrets)
        self._calls = 0
        self._held: list[Callable[[], None]] = []
        self._testbed = UMockdev.Testbed.new()
        self._testbed.add_device("spidev", NODE, None, ["dev", "153:0"], ["DEVNAME", f"/dev/{NODE}"])
        self._base = UMockdev.IoctlBase()
        self._base.connect("client-connected", self._connected)
        self._base.connect("handle-ioctl", self._handle_ioctl)
        self._testbed.attach_ioctl(f"/dev/{NODE}", self._base)
        self.root = Path(self._testbed.get_root_dir())
        self._node = self.root / "dev" / NODE
        self._sockets = self.root / "ioctl"
        self._hidden = self.root / "ioctl.hidden"
        self.restore_node()
        preload = [PRELOAD, *filter(None, [os.environ.get("LD_PRELOAD")])]
        emit({"is": "ready", "environment": {"UMOCKDEV_DIR": str(self.root), "LD_PRELOAD": ":".join(preload)}})

    def set(self, **faults: Any) -> None:
        """Change what holds for transfers from now on; what each means, and ends with, is in `tests/hil/bed.py`.

        A transfer that fails ends its message: what comes before it is on the wire, and what follows is not.
        """
        with self._lock:
            if "seed" in faults:
                self._chance = random.Random(faults.pop("seed"))  # noqa: S311  (faults, no secrets)
            self._faults.update(faults)

    def release(self) -> None:
        """Answer all held transfers, and hold no more."""
        with self._lock:
            self._faults["blocking"] = False
            held, self._held = self._held, []
        for answer in held:
            answer()

    def remove_node(self) -> None:
        """Take the device away: opening finds nothing, open descriptors are dead. Not with a real device behind it."""
        if Path("/dev", NODE).exists():
            raise OSError(f"this machine has a real /dev/{NODE}, which the programs under test would open instead")
        self._node.unlink(missing_ok=True)
        # Without sockets umockdev lets an opening fail as it would; with them it keeps an entry for each one in a
        # table of 50, and then aborts the child. One between open() and connect(), microseconds, still needs them.
        time.sleep(0.01)
        if self._sockets.exists():
            self._sockets.rename(self._hidden)
        with self._lock:
            self._gone_before = len(self._clients)

    def restore_node(self) -> None:
        """Bring the device back, as a new node (locks on the old one do not hold it)."""
        if self._hidden.exists():
            self._hidden.rename(self._sockets)
        if not self._node.exists():
            fresh = self._node.with_name(f".{NODE}")
            fresh.touch()
            fresh.rename(self._node)
        self._node.chmod(0o660)

    def _connected(self, _base: object, client: Any) -> None:
        """Number the client. No opening yet: umockdev connects also after an open() that failed."""
        with self._lock:
            self._clients[client] = len(self._clients) + 1

    def _opening(self, client: Any) -> int:
        """Return the number of this client's opening, which its first call makes known (spidev calls as it opens)."""
        if client not in self._openings:
            if not any(each.get_connected() for each in self._openings):  # umockdev notices a close some time after it
                self._speed_hz = DEFAULT_SPEED_HZ
            self._openings[client] = len(self._openings) + 1
        return self._openings[client]

    def _handle_ioctl(self, _base: object, client: Any) -> bool:
        now_ns = time.monotonic_ns()
        request = client.get_request()
        size, magic, number = request >> 16 & 0x3FFF, request >> 8 & 0xFF, request & 0xFF
        if magic != IOC_MAGIC or number > NR_MODE32:
            client.complete(-1, errno.ENOTTY)
            return True
        argument = client.get_arg().resolve(0, size)
        if number == NR_MESSAGE:
            self._message(now_ns, client, argument, size)
        elif request >> 30 & IOC_READ:
            self._read_setting(client, argument, number, size)
        else:
            value = int.from_bytes(bytes(argument.retrieve()), sys.byteorder)
            self._write_setting(client, number, value)
        return True

    def _message(self, now_ns: int, client: Any, argument: Any, size: int) -> None:
        raw = bytes(argument.retrieve())
        segments = []
        answer = bytes.fromhex(self._faults["answer"])
        filled: set[tuple[int, int]] = set()  # receive buffers that segments share
        for offset in range(0, size, SEGMENT.size):
            tx_buf, rx_buf, length, speed_hz, delay_us, bits, cs_change, *_ = SEGMENT.unpack_from(raw, offset)
            sent = bytes(argument.resolve(offset, length).retrieve()) if tx_buf and length else bytes(length)
            if rx_buf and length and (rx_buf, length) not in filled:  # each is a message to the program
                argument.resolve(offset + 8, length).update(0, answer[:length].ljust(length, b"\0"))
                filled.add((rx_buf, length))
            segments.append(Segment(sent, speed_hz, bits, delay_us, cs_change))
        self._transfer(now_ns, client, segments)

    def _transfer(self, now_ns: int, client: Any, segments: list[Segment]) -> None:
        with self._lock:
            opening, length, at_ns = self._opening(client), 0, now_ns
            self._calls += 1
            code = self._rejection(client, [segment.data for segment in segments])
            rejected = bool(code)
            about = {"is": "Transfer", "opening": opening, "mode": self._mode, "call": self._calls}
            about["held"] = blocking = self._faults["blocking"]
            for cycle in [segments] if rejected else self._cycles(segments):
                code = code or self._verdict()
                data = b"".join(segment.data for segment in cycle)
                about |= {"speed_hz": cycle[0].speed_hz or self._speed_hz, "bits_per_word": cycle[0].bits or self._bits}
                about |= {"segments": len(cycle), "pause_us": cycle[-1].delay_us}
                self._emit({**about, "monotonic_ns": at_ns, "data": data.hex(), "errno": code})
                length += len(data)
                if code:
                    break
                for segment in cycle:
                    at_ns += len(segment.data) * 8_000_000_000 // max(segment.speed_hz or self._speed_hz, SLOWEST_HZ)
                    at_ns += segment.delay_us * 1000
                at_ns += CS_CHANGE_NS
            if rejected:
                at_ns = now_ns
            if blocking:
                self._held.append(lambda: _answer(client, length, code))
                return
        while (left_ns := at_ns - CS_CHANGE_NS - time.monotonic_ns()) > 0:
            if left_ns > SPIN_NS:
                time.sleep((left_ns - SPIN_NS) / 1e9)
        _answer(client, length, code)

    def _cycles(self, segments: list[Segment]) -> list[list[Segment]]:
        """Return the segments in chip-select cycles."""
        cycles: list[list[Segment]] = [[]]
        for segment in segments:
            cycles[-1].append(segment)
            if segment.cs_change and segment is not segments[-1] and not self._faults["ignores_cs_change"]:
                cycles.append([])
        return cycles

    def _rejection(self, client: Any, data: list[bytes]) -> int:
        """Return why none of a call's transfers is made; 0: they are."""
        if self._clients[client] <= self._gone_before:
            return errno.ESHUTDOWN
        if len(data) > 1 and self._faults["list_errno"]:
            return int(self._faults["list_errno"])
        held = sum(-(-len(each) // ALIGNED) * ALIGNED for each in data)
        return errno.EMSGSIZE if held > BUFSIZ else 0

    def _verdict(self) -> int:
        """Return what becomes of the next transfer."""
        faults = self._faults
        if not faults["errno"]:
            return errno.EIO if faults["share"] and self._chance.random() < faults["share"] else 0
        if faults["after"]:
            faults["after"] -= 1
            return 0
        return int(faults["errno"])

    def _read_setting(self, client: Any, argument: Any, number: int, size: int) -> None:
        with self._lock:
            self._opening(client)
            gone = self._clients[client] <= self._gone_before
            values = {"mode": self._mode, "lsb_first": 0, "bits": self._bits, "speed": self._speed_hz}
        if not gone:
            argument.update(0, values[SETTINGS[number]].to_bytes(size, sys.byteorder))
        _answer(client, 0, errno.ESHUTDOWN if gone else 0)

    def _write_setting(self, client: Any, number: int, value: int) -> None:
        kind, code = SETTINGS[number], 0
        with self._lock:
            opening = self._opening(client)
            if self._clients[client] <= self._gone_before:
                code = errno.ESHUTDOWN
            elif kind == "mode" and not value & ~SUPPORTED_MODE_BITS:
                self._mode = value
            elif kind == "bits" and value in (0, 8):
                self._bits = 8
            elif kind == "speed" and value:
                self._speed_hz = value
            elif kind != "lsb_first" or value:
                code = errno.EINVAL
            self._emit({"is": "Setting", "kind": kind, "value": value, "opening": opening})
        _answer(client, 0, code)


def _answer(client: Any, result: int, code: int) -> None:
    """Complete a call; umockdev drops the answer to a caller that died meanwhile."""
    client.complete(-1 if code else result, code)


def serve(channel: socket.socket) -> None:
    """Obey the test kit until it closes its end."""
    write_lock = threading.Lock()

    def emit(event: dict[str, object]) -> None:
        with write_lock, suppress(OSError):
            channel.sendall(json.dumps(event).encode() + b"\n")

    bed = Testbed(emit)
    try:
        for line in channel.makefile("r", encoding="utf-8"):
            request: dict[str, Any] = json.loads(line)
            number, name = request.pop("id"), request.pop("do")
            error = None
            try:
                getattr(bed, name)(**request)
            except (OSError, ValueError) as reason:
                error = str(reason)
            if number:
                emit({"is": "reply", "id": number, "error": error})
    finally:
        shutil.rmtree(bed.root, ignore_errors=True)


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the test run, which then closes the socket
    with socket.socket(fileno=int(sys.argv[1])) as channel:
        serve(channel)


if __name__ == "__main__":
    main()
    os._exit(0)  # umockdev's thread has no end of its own
