"""The simulated power board in its process, and what it records, read as it comes."""

import json
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from gateway.model.power_board import SET_SUPPLY, SUPPLIED
from schemas.telemetry import GatewayState
from tests.support.child import Child
from tests.support.waiting import Closing

_MEANS: Final = {f"< t{SET_SUPPLY:03X}3": "mask", f"> t{SUPPLIED:03X}3": "answer", "= ": "fed"}
"""What of the record is kept: masks that arrive, the board's answers to them, and what it feeds."""


class Noted(NamedTuple):
    """A line of the record: what it is, when (monotonic ns), and its mask."""

    what: str
    at_ns: int
    mask: int


def answers_steadily() -> Callable[[GatewayState], bool]:
    """Whether the board has answered in each state of a second: a gateway that starts keeps its threads waiting."""
    row = 0

    def answers(state: GatewayState) -> bool:
        nonlocal row
        row = row + 1 if state.power is not None and state.power.alive else 0
        return row >= 10

    return answers


class RecordedBoard(Closing):
    """It is behind slcan at `channel` when the constructor returns.

    Stopped (SIGSTOP) it is an adapter that takes nothing; killed, one that was unplugged.
    """

    def __init__(self, folder: Path) -> None:
        self.channel = str(folder / "board" / "can")
        (folder / "board").mkdir()
        record = folder / "record"
        os.mkfifo(record)
        self.noted: list[Noted] = []
        """What has come up to now."""
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
        """A fault, as `gateway.simulation.board_port` names them."""
        self.child.tell(json.dumps(fault))

    @property
    def settings(self) -> dict[str, object]:
        """Return the table `[power]`. Its time for a confirmation outlasts the machine's load."""
        return {"interface": "slcan", "channel": self.channel, "confirm_ms": 2000}

    def next(self, what: str, mask: int | None = None, timeout_s: float = 20.0) -> Noted:
        """The next of this kind behind what was read before, with this mask if it is given; waits for it."""
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
        """Take all as read that has come up to now; returns how much that is."""
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
