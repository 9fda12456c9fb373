"""`stop-servos` cuts the servos' power: it sends a mask of nothing until the power board confirms it.

`PowerBoard` and python-can are loaded after the first Stops.
"""

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import OUTPUTS
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.power.interface import open_bus, receive, send

if TYPE_CHECKING:
    import can

TRY_NS: Final = 2 * NS_PER_S  # mutants accepted (Step): none is the only right one
"""How long masks are sent and a failed interface is reopened, from the end of the first opening on."""
LOAD_S: Final = 10.0  # mutants accepted (Step): none is the only right one
"""Time for the first opening, which loads python-can, perhaps from a slow card. systemd allows 20 s for everything."""
START_S: Final = 0.02  # mutants accepted (Step): none is the only right one
"""How long to wait for the first Stops on SPI: the imports here must not delay them, but they may hang."""
END_S: Final = 1.0  # mutants accepted (Step): none is the only right one
"""Further time after TRY_NS for calls that hang in python-can."""
NOT_CONFIRMED: Final = "the servos' supply is NOT confirmed to be off ({}): switch the power off by hand"
_RETRY_S: Final = 0.1
_POLL_S: Final = 0.005
_SEND_S: Final = 0.1  # mutants accepted (Step): none is the only right one


class SupplyCut:
    """Cuts the power on a thread of its own, after the first Stops, and reports the result."""

    def __init__(
        self,
        settings: PowerSettings,
        say: Callable[[str, bool], None],
        opener: "Callable[[PowerSettings], can.BusABC]" = open_bus,
    ) -> None:
        """`say` is called on that thread with a sentence, and with whether the board has confirmed it."""
        self._settings = settings
        self._say = say
        self._opener = opener
        self._begun_ns = time.monotonic_ns()
        self.stops_written = threading.Event()
        """Set once the first Stops were tried: the thread begins."""
        self._tried = threading.Event()
        """Set after the first attempt to open the interface."""
        self.confirmed = False
        self._thread = threading.Thread(target=self._run, name="supply cut", daemon=True)
        self._thread.start()

    def end(self) -> bool:
        """Wait until the thread has ended, but not if it hangs. Return whether the board has confirmed."""
        self.stops_written.set()
        self._tried.wait(LOAD_S)
        self._thread.join((TRY_NS / NS_PER_S) + END_S)
        if self._thread.is_alive():
            self._say(NOT_CONFIRMED.format("python-can hangs"), False)
        return self.confirmed

    def _run(self) -> None:
        self.stops_written.wait(START_S)
        why, end_ns = "the power board does not answer", 0
        # mutants accepted (Lt_LtE): equal times
        while not self.confirmed and (not end_ns or time.monotonic_ns() < end_ns):
            try:
                try:
                    bus = self._opener(self._settings)
                finally:
                    self._tried.set()
                    end_ns = end_ns or time.monotonic_ns() + TRY_NS
                self.confirmed = _cut(bus, self._settings, end_ns)
            except Exception as error:  # only another attempt can help
                why = str(error)
                time.sleep(_RETRY_S)
        if not self.confirmed:
            self._say(NOT_CONFIRMED.format(why), False)
            return
        took_ms = (time.monotonic_ns() - self._begun_ns) / NS_PER_MS
        self._say(f"the power board has confirmed: all servos without supply, after {took_ms:.0f} ms", True)


def _cut(bus: "can.BusABC", settings: PowerSettings, end_ns: int) -> bool:  # mutants accepted (Lt_LtE): equal times
    """Send masks until they are confirmed, or the time is over. Return whether they are confirmed."""
    from gateway.robot.power.board import PowerBoard  # noqa: PLC0415

    bus._is_shutdown = True  # else, as this process ends, python-can closes a channel that a gateway may use
    board = PowerBoard(range(1, OUTPUTS + 1), confirm_ns=TRY_NS)
    board.cut(time.monotonic_ns())
    while not board.confirmed and (now_ns := time.monotonic_ns()) < end_ns:
        board.not_sent(send(bus, board.next_frames(now_ns), _SEND_S), now_ns)
        for frame in receive(bus, settings, _POLL_S):
            board.receive(frame, time.monotonic_ns())
    return board.confirmed
