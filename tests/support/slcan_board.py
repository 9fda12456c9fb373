"""A simulated power board behind slcan on a pseudo terminal, in a process of its own: `… LINK`, which will name it.

It prints what happens, with the monotonic time in ns: `mask TIME HEX` when one arrives, `fed TIME HEX` when the board
feeds other outputs. It reads one command a line: `other HEX` (another node sends this mask), `flood RATE` (frames a
second of other nodes from now on), `faults SHARE SEED` (this share of its answers is lost, late or altered), `draws
OUTPUT MA`, `press`, `restart`. Stopped (SIGSTOP) it is an adapter that takes nothing; killed, one that was unplugged.
"""

import os
import random
import select
import sys
import time
import tty
from collections.abc import Iterator
from heapq import heappop, heappush
from pathlib import Path
from typing import Final, NamedTuple

from gateway.model.power_board import SET_SUPPLY, CanFrame
from gateway.robot.power.simulated_board import SimulatedBoard
from tests.support.child import Child
from tests.support.closing import Closing

LATE_NS: Final = 100_000_000
"""The longest that an answer is late."""
BURST_NS: Final = 1_000_000
"""Between two bursts of a flood."""
FOREIGN: Final = (CanFrame(0x123, bytes(8)), CanFrame(0x7B), CanFrame(0x6B, b"\1"), CanFrame(0x71, bytes(7)))
"""What a flood has: other identifiers, and those of the board with another length."""


def line_of(frame: CanFrame) -> bytes:
    """A frame in slcan."""
    return f"t{frame.id:03X}{len(frame.data)}{frame.data.hex().upper()}\r".encode()


class Adapter:
    """The board's end of the terminal."""

    def __init__(self, link: Path) -> None:
        self.board = SimulatedBoard(time.monotonic_ns())
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        link.symlink_to(os.ttyname(theirs))
        os.set_blocking(self._ours, False)
        self._held = theirs  # open, so that this end outlives each program
        self._left = b""
        self._fed = 0
        self._share = 0.0
        self._random = random.Random()  # noqa: S311
        self._late: list[tuple[int, bytes]] = []
        self._flood_ns = 0
        """Between two frames of it; 0: there is none."""
        self._flooded_ns = 0

    def play(self) -> None:
        """Until the standard input ends."""
        told = b""
        while True:
            now_ns = time.monotonic_ns()
            due_ns = [self.board.due_ns, *(at_ns for at_ns, _ in self._late[:1])]
            due_ns += [self._flooded_ns + BURST_NS] if self._flood_ns else []
            wait_s = max(0, min(due_ns) - now_ns) / 1e9
            ready, _, _ = select.select([self._ours, sys.stdin], [], [], wait_s)
            if sys.stdin in ready:
                data = os.read(sys.stdin.fileno(), 4096)
                if not data:
                    return
                *lines, told = (told + data).split(b"\n")
                for line in lines:
                    self._command(*line.decode().split())
            if self._ours in ready:
                for frame in self._arrived():
                    now_ns = time.monotonic_ns()
                    if frame.id == SET_SUPPLY:
                        print(f"mask {now_ns} {frame.data.hex()}", flush=True)
                    self._answer(self.board.take(frame, now_ns), now_ns)
            now_ns = time.monotonic_ns()
            self._answer(self.board.advance(now_ns), now_ns)
            self._flood(now_ns)
            while self._late and self._late[0][0] <= now_ns:
                self._write(heappop(self._late)[1])
            if self.board.fed != self._fed:
                self._fed = self.board.fed
                print(f"fed {now_ns} {self._fed:06x}", flush=True)

    def _command(self, what: str, *values: str) -> None:
        now_ns = time.monotonic_ns()
        match what:
            case "other":
                frame = CanFrame(SET_SUPPLY, bytes.fromhex(values[0]))
                os.set_blocking(self._ours, True)  # of all frames, this one is not lost
                self._write(line_of(frame))
                os.set_blocking(self._ours, False)
                self._answer(self.board.take(frame, now_ns), now_ns)
            case "flood":
                self._flood_ns, self._flooded_ns = int(1e9 / float(values[0])), now_ns
            case "faults":
                self._share = float(values[0])
                self._random.seed(int(values[1]))
            case "draws":
                self.board.draws_ma[int(values[0]) - 1] = float(values[1])
            case "press":
                self.board.press_button(now_ns)
            case "restart":
                self.board.restart()

    def _arrived(self) -> Iterator[CanFrame]:
        """The frames that have come; the adapter's own commands mean nothing here."""
        try:
            data = self._left + os.read(self._ours, 4096)
        except BlockingIOError:
            return
        *lines, self._left = data.split(b"\r")
        for line in lines:
            if line[:1] == b"t":
                yield CanFrame(int(line[1:4], 16), bytes.fromhex(line[5:].decode()))

    def _answer(self, frames: list[CanFrame], now_ns: int) -> None:
        for frame in frames:
            fault = self._random.randrange(4) if self._random.random() < self._share else None
            if fault == 0:
                continue
            if fault == 1:
                heappush(self._late, (now_ns + self._random.randrange(LATE_NS), line_of(frame)))
                continue
            data = frame.data if fault is None else self._random.randbytes(len(frame.data))
            self._write(line_of(CanFrame(frame.id, data[:-1] if fault == 2 else data)))

    def _flood(self, now_ns: int) -> None:
        burst = b""
        while self._flood_ns and self._flooded_ns + self._flood_ns <= now_ns:
            self._flooded_ns += self._flood_ns
            burst += line_of(FOREIGN[self._flooded_ns // self._flood_ns % len(FOREIGN)])
        self._write(burst)

    def _write(self, data: bytes) -> None:
        """What nobody reads is lost, once the kernel keeps no more."""
        try:
            os.write(self._ours, data)
        except BlockingIOError:
            return


class Noted(NamedTuple):
    """A line that the board printed."""

    what: str
    at_ns: int
    mask: int


class BoardProcess(Closing):
    """The process, ready when the constructor returns."""

    def __init__(self, folder: Path) -> None:
        self.link = folder / "can"
        self.child = Child([sys.executable, "-m", "tests.support.slcan_board", str(self.link)], os.environ)
        self.child.wait_for_line(0)
        self.noted: list[Noted] = []
        """What was read of it up to now."""

    def close(self) -> None:
        self.child.close()

    @property
    def settings(self) -> dict[str, object]:
        """Of `[power]`. Nothing counts as unconfirmed that only the machine's load makes wait."""
        return {"interface": "slcan", "channel": str(self.link), "confirm_ms": 2000}

    def next(self, what: str, mask: int | None = None, timeout_s: float = 20.0) -> Noted:
        """The next line about that, after what was read before, with this mask if it is given; waits for it."""
        while (noted := self.next_line(timeout_s)).what != what or mask not in (None, noted.mask):
            pass
        return noted

    def skip(self) -> int:
        """Read all that it has printed up to now. Returns how many lines that are in all."""
        while len(self.child.stdout.splitlines()) > 1 + len(self.noted):
            self.next_line()
        return len(self.noted)

    def next_line(self, timeout_s: float = 20.0) -> Noted:
        """The next line, whatever it is; waits for it."""
        word, at_ns, found = self.child.wait_for_line(1 + len(self.noted), timeout_s).split()
        self.noted.append(Noted(word, int(at_ns), int(found, 16)))
        return self.noted[-1]


if __name__ == "__main__":
    adapter = Adapter(Path(sys.argv[1]))
    print("ready", flush=True)
    adapter.play()
