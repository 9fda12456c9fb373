"""Simulated power boards: under python-can in this process, under slcan, and in a process that records."""

import json
import os
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

import can

from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import ALL, SET_SUPPLY, SUPPLIED, CanFrame, set_supply
from gateway.simulation.board import SimulatedBoard
from gateway.simulation.board_port import Device, SimulatedAdapter
from schemas.gateway_state import GatewayState
from tests.support.child import Child
from tests.support.waiting import Closing

_PASS_NS = 100_000
"""The board's pass, faster than that of the real one."""


class BoardBus(can.BusABC):
    """A CAN bus with a power board, which feeds all servos at first."""

    def __init__(self, *, silent: bool = False) -> None:
        """`silent`: the board answers nothing."""
        super().__init__("board")
        self._is_shutdown = True  # there is nothing to close
        now_ns = time.monotonic_ns()
        self.board = SimulatedBoard(now_ns - 1_000_000_000, pass_ns=_PASS_NS)
        self.board.take(set_supply(ALL), now_ns - 1_000_000_000)
        self.board.advance(now_ns)
        self.silent = silent
        self.failures: list[Exception] = []
        """The errors that the next openings raise."""
        self.fails: Exception | None = None
        """The error that each attempt to send raises."""
        self.tries = 0
        self.more: deque[can.Message] = deque()
        """Messages that are received besides the board's answers."""
        self.closed = threading.Event()
        self.sent: list[CanFrame] = []
        self.first_sent = threading.Event()
        self.hangs = threading.Event()
        """Not set: a frame is never sent, and the interface never closed."""
        self.hangs.set()
        self._frames: deque[CanFrame] = deque()

    def opened(self, _settings: PowerSettings) -> "BoardBus":
        """Open the bus, as `open_bus` does."""
        if self.failures:
            raise self.failures.pop(0)
        return self

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        assert timeout
        self.tries += 1
        if (fails := self.fails) is not None:  # another thread may change it now
            raise fails
        frame = CanFrame(msg.arbitration_id, bytes(msg.data))
        self.sent.append(frame)
        self.hangs.wait()
        self.first_sent.set()
        self._frames += self.board.take(frame, time.monotonic_ns())

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.more:
            return self.more.popleft(), True
        self._frames += self.board.advance(time.monotonic_ns())
        if not self._frames or self.silent:
            time.sleep(min(timeout or 0, 0.001))
            return None, True
        frame = self._frames.popleft()
        return can.Message(arbitration_id=frame.id, is_extended_id=False, data=frame.data), True

    def shutdown(self) -> None:
        self.closed.set()
        self.hangs.wait()

    def answer(self, identifier: int, data: bytes = b"", **fields: bool) -> None:
        self.more.append(can.Message(arbitration_id=identifier, data=data, **{"is_extended_id": False, **fields}))


TICK_MS = 1


class Adapter(Device):
    """An slcan adapter with a power board. It serves until `unplug`."""

    say = Device.write

    def __init__(self, link: str) -> None:
        """Serve at `link`: the path that leads to the terminal."""
        super().__init__(Path(link))
        self.board = SimulatedBoard(time.monotonic_ns())
        self.received: list[bytes] = []
        """The program's lines."""
        self._ends = threading.Event()
        self._reads = threading.Event()
        self._reads.set()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        self._ends.set()
        self._thread.join()
        os.close(self._theirs)
        os.close(self.fd)

    def pause(self) -> None:
        self._reads.clear()

    def go_on(self) -> None:
        self._reads.set()

    def _serve(self) -> None:
        adapter = SimulatedAdapter()
        while not self._ends.is_set():
            self._reads.wait()
            select.select([self.fd], [], [], TICK_MS / 1000)
            data = self.read()
            self.received += data.split(b"\r")[:-1]
            frames, answers = adapter.take(data)
            self.write(answers)
            for frame in frames:
                self.write(b"".join(map(adapter.text, self.board.take(frame, time.monotonic_ns()))))
            self.write(b"".join(map(adapter.text, self.board.advance(time.monotonic_ns()))))


_MEANS: Final = {f"< t{SET_SUPPLY:03X}3": "mask", f"> t{SUPPLIED:03X}3": "answer", "= ": "fed"}
"""The lines of the record that are kept: masks that arrive, the board's answers to them, and what it feeds."""


class Noted(NamedTuple):
    """A line of the record: what it is, when (monotonic ns), and its mask."""

    what: str
    at_ns: int
    mask: int


def answers_steadily() -> Callable[[GatewayState], bool]:
    """Return whether the board has answered in each state of a second: a starting gateway keeps its threads waiting."""
    row = 0

    def answers(state: GatewayState) -> bool:
        nonlocal row
        row = row + 1 if state.power is not None and state.power.alive else 0
        return row >= 10

    return answers


class RecordedBoard(Closing):
    """A power board in a process, under slcan at `channel` when the constructor returns.

    Stopped (SIGSTOP) it is an adapter that takes nothing; killed, one that was unplugged.
    """

    def __init__(self, folder: Path) -> None:
        self.channel = str(folder / "board" / "can")
        (folder / "board").mkdir()
        record = folder / "record"
        os.mkfifo(record)
        self.noted: list[Noted] = []
        """The lines so far."""
        self._read = 0
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._follow, args=(record,), daemon=True)
        self._reader.start()
        given = json.dumps({"folder": str(folder / "board"), "record": str(record)})
        self.child = Child([sys.executable, "-m", "gateway.simulation.board_port", given], os.environ)
        self.child.wait_for_line(0)
        if os.geteuid() == 0:  # it stands for hardware, which no load slows
            os.sched_setscheduler(self.child.pid, os.SCHED_FIFO, os.sched_param(50))

    def close(self) -> None:
        self.child.close()
        self._reader.join()

    def disturb(self, **fault: object) -> None:
        """Cause a fault, as `gateway.simulation.board_port` names them."""
        self.child.tell(json.dumps(fault))

    @property
    def settings(self) -> dict[str, object]:
        """Return the table `[power]`. Its time for a confirmation outlasts the machine's load."""
        return {"interface": "slcan", "channel": self.channel, "confirm_ms": 2000}

    def next(self, what: str, mask: int | None = None, timeout_s: float = 20.0) -> Noted:
        """Wait for the next of this kind after what was read before, with this mask if it is given, and return it."""
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            while True:
                while self._read < len(self.noted):
                    found = self.noted[self._read]
                    self._read += 1
                    if found.what == what and mask in (None, found.mask):
                        return found
                if not self._changed.wait(deadline_s - time.monotonic()):
                    raise TimeoutError(f"no {what} {mask}; noted were {self.noted[-30:]}; {self.child}")

    def skip(self) -> int:
        """Mark everything received until now as read, and return its count."""
        with self._changed:
            self._read = len(self.noted)
            return self._read

    def _follow(self, record: Path) -> None:
        with record.open() as lines:
            for line in lines:
                at_ns, _, rest = line.partition(" ")
                for begin, what in _MEANS.items():
                    if rest.startswith(begin):
                        with self._changed, suppress(ValueError):  # an altered answer may have any bytes
                            self.noted.append(Noted(what, int(at_ns), int(rest.removeprefix(begin).split()[0], 16)))
                            self._changed.notify_all()
