"""A python-can bus with a simulated power board at its other end, in this process."""

import threading
import time
from collections import deque

import can

from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import ALL, CanFrame, set_supply
from gateway.simulation.board import SimulatedBoard

_PASS_NS = 100_000
"""A board that is faster than the real one."""


class BoardBus(can.BusABC):
    """All servos are fed at first."""

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
        """Raised by the next openings."""
        self.fails: Exception | None = None
        """Raised by each attempt to send."""
        self.tries = 0
        self.more: deque[can.Message] = deque()
        """Received, as well as what the board answers."""
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
        """Let this frame be received."""
        self.more.append(can.Message(arbitration_id=identifier, data=data, **{"is_extended_id": False, **fields}))
