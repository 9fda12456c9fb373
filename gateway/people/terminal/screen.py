"""The frame of a program that fills the terminal: keys, a Stop key whose Stop is confirmed, drawing, and the end.

Keys are read on the calling thread, pictures are drawn on another, and Stops are requested on threads of their own, so
none waits for another: the Stop key works while the terminal takes no more output, and while the gateway is frozen.
"""

import os
import select
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Final

import zenoh
from rich.console import Console
from rich.live import Live
from rich.text import Text

from gateway.errors import GatewayError
from gateway.people.client.subscriptions import reports, subscribed
from gateway.people.client.until_confirmed import UntilConfirmed
from gateway.people.terminal import hint
from gateway.people.terminal.keyboard import Keyboard, keys_at_once, wake_on_signals
from gateway.people.terminal.stop_status import Remark, StopStatus, Tone
from schemas import keys as wire
from schemas.telemetry import Ack, Event, GatewayState

FRAME_S: Final = 0.1
"""Ages count up, so it draws ten times a second."""
LEAST_FRAME_S: Final = 0.03
"""Shortest time between two pictures, however much happens: drawing must not load the robot's computer."""
DRAWER_END_S: Final = 0.5
SMALL_ROWS: Final = 4
"""In a terminal with fewer rows, a Stop that is not confirmed replaces everything else."""
NOT_STOPPED: Final = "The emergency stop was NOT confirmed: switch the servos' power off."
STOP_KEYS: Final = frozenset(" eExX")
ALARM: Final = "bold white on red"
STYLES: Final = {Tone.GOOD: "bold green", Tone.NOTE: "cyan", Tone.BAD: ALARM}
_READ: Final = 4096
"""All that a terminal keeps: keys that were pressed while this program could not run count as one reading."""


class Screen(ABC):
    """Shown by `show`, until a key, a signal or a fault ends it."""

    def __init__(self, estop: Callable[[], Ack]) -> None:
        """`estop` requests the emergency stop, and may wait or raise; it is called on threads of its own."""
        self.lock = threading.Lock()
        """Of what is shown. Held for moments only."""
        self.changed = threading.Event()
        """Set to draw soon."""
        self.stop = StopStatus()
        self.failures: list[str] = []
        """Sentences. Where drawing fails, the program ends: an old picture must not pass for the present state."""
        self.drawn_s = float("-inf")
        """When the terminal last took a whole picture, by the monotonic clock."""
        self._stops = UntilConfirmed(estop, self.stop_answered)
        self._noted = threading.Event()
        """Whether `stop` knows of the newest press."""
        self._ended = threading.Event()
        self._wake = -1
        # The terminal's own size: what a shell has exported of it is not that of a window that was made smaller since.
        environ = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
        self._console = Console(_environ=environ)
        self._live = Live(console=self._console, screen=True, auto_refresh=False, redirect_stderr=False)
        self._drawer = threading.Thread(target=self._draw, name="draw", daemon=True)

    # ---- what a program states: none of these waits, but `end`

    @abstractmethod
    def begin(self) -> None:
        """Before the first picture."""

    def press(self, key: str) -> bool:
        """Act on a key that is neither a Stop nor Ctrl-C; whether to go on."""
        del key
        return True

    @abstractmethod
    def picture(self, columns: int, rows: int) -> Text:
        """What is shown now; on the thread that draws, without the lock."""

    @abstractmethod
    def end(self) -> None:
        """Make the robot safe, and release it. Pictures are still drawn meanwhile. Raises GatewayError."""

    def stops(self, keys: list[str]) -> bool:
        """Whether the keys of one reading request the emergency stop. Where they do, the others do nothing."""
        return not STOP_KEYS.isdisjoint(keys)

    def last_words(self) -> list[str]:
        """What a person must know once the screen is gone."""
        if self.stop.wanted_ns is not None:
            return [NOT_STOPPED]
        return [self.stop.power.sentence] if self.stop.power.sentence else []

    # ---- what it does for a program

    def show(self) -> int:
        """Show it until its end; the exit code."""
        terminal = sys.stdin.fileno()
        with keys_at_once(terminal), wake_on_signals() as (woken, self._wake):
            self.begin()
            self._drawer.start()
            try:
                self._read_keys(terminal, woken)
            finally:
                try:
                    self.end()
                except GatewayError as error:
                    self.failures.append(str(error))
                finally:
                    self._ended.set()
                    self.changed.set()
                    self._drawer.join(DRAWER_END_S)
        return 1 if self.failures else 0

    @contextmanager
    def changes(self) -> Iterator[None]:
        """What is shown changes: with the lock, and drawn soon."""
        with self.lock:
            yield
        self.changed.set()

    def take_stop_back(self) -> None:
        """The person asks for the reset: Stops pressed so far are not requested again. With the lock."""
        self._stops.take_back()
        self.stop.reset()

    def stop_remark(self, *, live: bool = False) -> Remark | None:
        """The sentence about the Stop. `live`: whether the gateway still publishes."""
        with self.lock:
            return self.stop.remark(time.monotonic_ns(), live=live)

    # ---- received

    def receives(self, session: zenoh.Session) -> AbstractContextManager[object]:
        """Take the gateway's states and events for the time of a `with`."""
        taken = {wire.STATE: reports(GatewayState, self.take_state), wire.EVENT: reports(Event, self.take_event)}
        return subscribed(session, taken)

    def take_state(self, state: GatewayState) -> None:
        """The gateway's state; on a thread of Zenoh's."""
        with self.changes():
            self.stop.power.received_state(state, time.monotonic_ns())

    def take_event(self, event: Event) -> None:
        """An event of the gateway's; on a thread of Zenoh's."""
        with self.changes():
            self.stop.power.received_event(event.kind)

    # ---- keys

    def _read_keys(self, terminal: int, woken: int) -> None:
        keyboard = Keyboard()
        while True:
            ready, _, _ = select.select([terminal, woken], [], [])
            if woken in ready:
                return
            try:
                data = os.read(terminal, _READ)
            except OSError:  # the terminal is gone
                return
            if not data or not self._act_on(keyboard.keys(data, time.monotonic())):
                return
            self.changed.set()

    def _act_on(self, keys: list[str]) -> bool:
        """Act on one reading, a Stop first; whether to go on."""
        if self.stops(keys):
            self.request_stop()
            return True
        return all(key != "ctrl-c" and self.press(key) for key in keys)

    def request_stop(self) -> None:
        """A Stop key was pressed: request it at once and without waiting, and again until it is confirmed."""
        self._noted.clear()
        self._stops.press()  # first: not even the lock stands between the key and the wire
        with self.changes():
            self.stop.press(time.monotonic_ns())
        self._noted.set()

    def stop_answered(self, outcome: Ack | Exception) -> bool:
        """What became of a request; whether the Stop is still wanted. On a thread that requests Stops."""
        self._noted.wait()
        with self.changes():
            if not isinstance(outcome, Ack):
                self.stop.unanswered()
                return self.stop.wanted_ns is not None
            self.stop.confirm(outcome, self._stops.since_ns, time.monotonic_ns())
        return True

    # ---- drawing

    def _draw(self) -> None:
        try:
            with self._live:
                while not self._ended.is_set():
                    self.changed.clear()
                    # Shown without any lock: this waits for the terminal.
                    self._live.update(self.picture(*self._console.size), refresh=True)
                    self.drawn_s = time.monotonic()
                    self._ended.wait(LEAST_FRAME_S)
                    self.changed.wait(FRAME_S - LEAST_FRAME_S)
        except Exception as error:
            why = f"this terminal cannot be drawn on ({error}); it needs UTF-8, such as LC_ALL=C.UTF-8"
            self.failures.append(why)
            os.write(self._wake, b".")
            self._ended.wait()
        with suppress(OSError):  # the terminal is gone; in one that is stuck this waits, as drawing does
            for line in (*(f"hexapod-gateway: {failure}" for failure in self.failures), *self.last_words()):
                hint(line)


def fitted(lines: list[Text], keys: Text, columns: int, rows: int, stop: Remark | None = None) -> Text:
    """A picture of exactly `rows` rows of at most `columns`: the first lines that fit, and in the last row the keys.

    In fewer than SMALL_ROWS rows a Stop that is not confirmed replaces the lines, and in a single row the keys, too.
    """
    last = Text(" SPACE or e: EMERGENCY STOP ", ALARM).append_text(keys)
    if stop is not None and stop.tone is Tone.BAD and rows < SMALL_ROWS:
        lines = [Text(f" {stop.text} ", ALARM)]
        last = lines[0] if rows == 1 else last
    shown = lines[: rows - 1]
    shown += [Text()] * (rows - 1 - len(shown))
    shown.append(last)
    for line in shown:
        line.truncate(columns)
    return Text("\n", no_wrap=True, overflow="crop", end="").join(shown)
