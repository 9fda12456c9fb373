"""`stop-servos` takes the servos' supply: a mask of nothing, until the power board confirms it.

`PowerBoard` does more, and its imports take longer than all Stops. This loads python-can alone.
"""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.errors import ConfigError
from gateway.host.settings_table import PowerSettings
from gateway.model.power_board import CanFrame, Rails, Supplied, read, set_supply
from gateway.robot.power.interface import BusyError, LineError, open_bus, received, send
from gateway.robot.power.questions import BoardQuestions

if TYPE_CHECKING:
    import can

REPEAT_NS: Final = 20 * NS_PER_MS
REST_NS: Final = 5 * NS_PER_MS
"""Behind an answer 6B, in whose pass the board takes a mask 230 passes later."""
TRY_NS: Final = 2 * NS_PER_S
"""How long masks are sent, and the interface is opened again where it fails, from the end of the first opening on."""
LOAD_S: Final = 10.0
"""How long that may take: it loads python-can, from a card that is slow to read. systemd gives all of this 20 s."""
START_S: Final = 0.02
"""How long the first Stops on SPI are waited for: what is loaded here must not delay them, and they may hang."""
END_S: Final = 1.0
"""Beyond TRY_NS, for what hangs in python-can: then nobody waits any longer."""
_RETRY_S: Final = 0.1
_LOOK_S: Final = 0.005
_SEND_S: Final = 0.1


class LastCut:
    """All outputs off: what to send, and whether it is confirmed. Pure; times are monotonic.

    Confirmed is a 6B that shows all off, behind the answer to a question that was sent after the first mask: an answer
    to somebody else's mask may be on its way.
    """

    def __init__(self) -> None:
        """On an interface that was just opened."""
        self._questions = BoardQuestions()
        self._due_ns = 0
        self.confirmed = False

    def next_frames(self, now_ns: int) -> list[CanFrame]:
        """What leaves now: the mask, a question whose answer proves that it has arrived, and questions in turn."""
        frames: list[CanFrame] = []
        if self.confirmed:
            return frames
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + REPEAT_NS
            frames = [set_supply(0), *self._questions.due_after(1, now_ns)]
        if now_ns >= self._questions.due_ns:
            frames += self._questions.next(1, now_ns)
        return frames

    def receive(self, frame: CanFrame, now_ns: int) -> None:
        """A frame was on the bus."""
        self._questions.asked_by_another(frame, now_ns)
        answer = read(frame)
        if answer is not None:
            self._questions.answered(now_ns)
        match answer:
            case Supplied(mask):
                proven = self._questions.reached > 0 and not self._questions.doubles  # another board may feed them
                self.confirmed = self.confirmed or (mask == 0 and proven)
                self._due_ns = max(self._due_ns, now_ns + REST_NS)
            case Rails(question):
                self._questions.answered_about_rails(CanFrame(question), now_ns)


class SupplyCut:
    """Takes the supply on a thread of its own, which begins behind the first Stops, and reports how it ended."""

    def __init__(
        self,
        settings: PowerSettings,
        say: Callable[[str, bool], None],
        opener: "Callable[[PowerSettings], can.BusABC]" = open_bus,
    ) -> None:
        """`say`, called on that thread, gets a sentence, and whether the board has confirmed it."""
        self._settings = settings
        self._say = say
        self._opener = opener
        self._begun_ns = time.monotonic_ns()
        self._stops_written = threading.Event()
        self._tried = threading.Event()
        """The interface was opened, or could not be."""
        self.confirmed = False
        self._thread = threading.Thread(target=self._run, name="supply cut", daemon=True)
        self._thread.start()

    def stops_written(self) -> None:
        """The first Stops were tried."""
        self._stops_written.set()

    def end(self) -> bool:
        """Wait until it has ended, but not for what hangs; whether the board has confirmed it."""
        self._stops_written.set()
        self._tried.wait(LOAD_S)
        self._thread.join((TRY_NS / NS_PER_S) + END_S)
        if self._thread.is_alive():
            self._say(not_confirmed("python-can hangs"), False)
        return self.confirmed

    def _run(self) -> None:
        self._stops_written.wait(START_S)
        why, end_ns = "the power board does not answer", 0
        while not self.confirmed and (not end_ns or time.monotonic_ns() < end_ns):
            try:
                try:
                    bus = self._opener(self._settings)
                finally:
                    self._tried.set()
                    end_ns = end_ns or time.monotonic_ns() + TRY_NS
                self.confirmed = _cut(bus, self._settings, end_ns)
            except ConfigError as error:
                why = str(error)
                break
            except Exception as error:  # from any of python-can's interfaces: another attempt is all that helps
                where = "" if isinstance(error, LineError) else f"{self._settings.interface} {self._settings.channel}: "
                why = f"{where}{error}"
                time.sleep(_RETRY_S)
        if not self.confirmed:
            self._say(not_confirmed(why), False)
            return
        took_ms = (time.monotonic_ns() - self._begun_ns) / NS_PER_MS
        self._say(f"the power board has confirmed: all servos without supply, after {took_ms:.0f} ms", True)


def not_confirmed(why: str) -> str:
    """The sentence for a person."""
    return f"the servos' supply is NOT confirmed to be off ({why}): switch the power off by hand"


def _cut(bus: "can.BusABC", settings: PowerSettings, end_ns: int) -> bool:
    """Until it is confirmed, or the time is over."""
    bus._is_shutdown = True  # this process ends: python-can would close the adapter's channel, and a gateway may use it
    cut = LastCut()
    while not cut.confirmed and (now_ns := time.monotonic_ns()) < end_ns:
        with suppress(BusyError):  # it is sent again
            for frame in cut.next_frames(now_ns):
                send(bus, frame, _SEND_S)
        message = bus.recv(_LOOK_S)
        answer = None if message is None else received(message, settings)
        if answer is not None:
            cut.receive(answer, time.monotonic_ns())
    return cut.confirmed
