"""The power board on its interface: two threads around `PowerBoard`, by python-can.

| thread   | does                                              | may hang                    |
|----------|---------------------------------------------------|-----------------------------|
| sender   | opens, closes, sends                              | in python-can or the kernel |
| receiver | receives, checks the time every 10 ms, reports    | no: `recv` has a limit      |

Callers of `cut` and `request` wait for neither thread: the request is queued, and either thread takes it. So a
sender that hangs delays no Stop on SPI, and a silent board is still reported.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Final

from gateway.host import realtime
from gateway.host.descriptors import NO_SPARE, Spare
from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import CanFrame, set_supply
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.power.board import Confirmed, News, PowerBoard, Status
from gateway.robot.power.interface import LineError, open_bus, receive, send

if TYPE_CHECKING:
    import can

POLL_S: Final = 0.01
"""How long the receiver waits for a frame, and so its latest check of the time."""
SEND_S: Final = 0.1
"""How long a frame may wait to be sent, if python-can respects that. Later, the interface hangs or the bus is off."""
SHOWN: Final = slice(Status._fields.index("answered_ns"))
"""The fields of a status whose change is news."""


class PowerLine:
    """A board and its interface, from `start` to `close`. Any thread may read `status`, and request."""

    def __init__(
        self,
        settings: PowerSettings,
        failed: Callable[[Exception], None],
        *,
        opener: "Callable[[PowerSettings], can.BusABC]" = open_bus,
        spare: Spare = NO_SPARE,
    ) -> None:
        """`failed` is called with an unexpected exception that ended one of the threads.

        `spare` are descriptors kept for the interface while it is closed.
        """
        self._settings = settings
        self._board = PowerBoard(settings.outputs, confirm_ns=round(settings.confirm_ms * NS_PER_MS))
        self.on_news: Callable[[list[News | Confirmed]], None] = lambda _: None
        """Called on the receiver's thread for news or a changed status. It must not wait."""
        self._failed = failed
        self._opener = opener
        self._spare = spare
        self._requests: deque[Callable[[PowerBoard, int], None]] = deque()
        self._lock = threading.Lock()
        """Held while the board is used, not while frames are sent or received."""
        self._wake = threading.Lock()
        """Released if the sender has work. Releasing a lock does not give up the interpreter's lock."""
        self._wake.acquire()
        self._bus: can.BusABC | None = None
        self._receiving = threading.Lock()
        """Held by the receiver while it uses the interface."""
        self._closing = self._cuts = False
        self._retry_ns = 0
        self.status = Status()
        self.polled_ns = time.monotonic_ns()
        """When the receiver last checked the time, by which a stuck thread is noticed."""
        self._sender = threading.Thread(target=self._run, args=(self._send,), name="power sender", daemon=True)
        self._receiver = threading.Thread(target=self._run, args=(self._receive,), name="power receiver", daemon=True)

    def start(self) -> None:
        """Open the interface, or let the sender try until it opens. Raises ConfigError if it never can."""
        self._open()
        self._receiver.start()
        self._sender.start()

    def close(self, timeout_s: float = 1.0) -> None:
        """Send the frames that are due, and end the threads. Blocks for `timeout_s` at most."""
        self._closing = True
        self._awake()
        end_ns = time.monotonic_ns() + round(timeout_s * NS_PER_S)
        for thread in (self._sender, self._receiver):
            thread.join(max(0, end_ns - time.monotonic_ns()) / NS_PER_S)

    def cut(self) -> None:
        """Request PowerBoard.cut. Its first mask leaves even before."""
        self._cuts = True
        self.request(PowerBoard.cut)

    def request(self, act: Callable[[PowerBoard, int], None]) -> None:
        """Have one of the threads call `act` with the board and now (ns), in the order of requests. Never waits."""
        self._requests.append(act)
        self._awake()

    def _awake(self) -> None:
        with suppress(RuntimeError):  # the sender is awake already
            self._wake.release()

    # ---- both threads

    def _run(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception as error:
            self._failed(error)

    def _take_requests(self) -> None:
        """Carry out the queued requests, in their order. The caller holds the lock."""
        while self._requests:
            self._requests.popleft()(self._board, time.monotonic_ns())

    def _open(self) -> None:
        """Try to open the interface. Raises ConfigError if it never can."""
        with suppress(LineError):
            bus = self._spare.open(partial(self._opener, self._settings))
            with self._lock:
                self._bus = bus
                self._board.opened(time.monotonic_ns())

    def _lose(self, bus: "can.BusABC | None", error: LineError) -> None:
        """Record that the interface is gone. Neither thread uses it any more."""
        with self._lock:
            if self._bus is bus:
                self._bus = None
                self._board.fall_silent(f"the interface of the power board is gone: {error}", time.monotonic_ns())
        self._awake()

    # ---- the sender

    def _send(self) -> None:
        realtime.prefer_thread(realtime.LOOP_PRIORITY)
        while True:
            closing = self._closing
            bus = self._bus
            if bus is None:
                if closing:
                    return
                # Ten times a second at most: with the bus off, it opens but sends nothing.
                time.sleep(max(0, self._retry_ns - time.monotonic_ns()) / NS_PER_S)
                self._retry_ns = time.monotonic_ns() + 100 * NS_PER_MS
                self._open()
                continue
            self._send_due(bus)
            if closing:
                self._bus = None
            if self._bus is not bus:
                self._release(bus)
                continue
            with self._lock:
                wait_ns = 0 if self._requests else self._board.due_ns - time.monotonic_ns()
            self._wake.acquire(timeout=max(0, wait_ns) / NS_PER_S)

    def _send_due(self, bus: "can.BusABC") -> None:
        try:
            if self._cuts:
                self._cuts = False
                send(bus, [set_supply(0)], SEND_S)  # without room for it, the mask of `cut` follows
                time.sleep(0.001)  # the Stops on SPI have the interpreter
            with self._lock:
                self._take_requests()
                frames = self._board.next_frames(time.monotonic_ns())
            left = send(bus, frames, SEND_S)
            if left:
                with self._lock:
                    self._board.not_sent(left, time.monotonic_ns())
                time.sleep(0.002)  # the queue's ten frames leave within 1.3 ms at 1 Mbit/s
        except LineError as error:
            self._lose(bus, error)

    def _release(self, bus: "can.BusABC") -> None:
        """Close the interface once neither thread uses it, since its descriptor may then become another file's."""
        with self._receiving:
            pass  # the receiver has begun anew; it must not wait for an adapter that hangs below
        with suppress(Exception):
            bus.shutdown()
        self._spare.fill()

    # ---- the receiver

    def _receive(self) -> None:
        realtime.prefer_thread(realtime.RECEIVER_PRIORITY)
        while not self._closing:
            frames: list[CanFrame] = []
            with self._receiving:
                bus = self._bus
                try:
                    frames = [] if bus is None else receive(bus, self._settings, POLL_S)
                except LineError as error:
                    self._lose(bus, error)
            if bus is None:
                time.sleep(POLL_S)
            self._take(frames)

    def _take(self, frames: list[CanFrame]) -> None:
        before = self.status
        with self._lock:
            self._take_requests()
            now_ns = self.polled_ns = time.monotonic_ns()
            for frame in frames:
                self._board.receive(frame, now_ns)
            self._board.poll(now_ns)
            self.status = self._board.status
            news, self._board.news = self._board.news, []
            due = self._board.due_ns <= now_ns
        if due:
            self._awake()
        if news or before[SHOWN] != self.status[SHOWN]:
            self.on_news(news)
