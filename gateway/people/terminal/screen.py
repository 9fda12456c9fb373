"""A program that fills the terminal: keys on the calling thread, drawing on another, and neither waits for it."""

import os
import select
import sys
import threading
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.text import Text

from gateway.errors import GatewayError
from gateway.people.terminal import hint
from gateway.people.terminal.keyboard import Keyboard, keys_at_once, wake_on_signals

FRAME_S: Final = 0.1
"""Ages count up, so it draws ten times a second."""
LEAST_FRAME_S: Final = 0.03
"""Shortest time between two pictures, however much happens: drawing must not load the robot's computer."""
DRAWER_END_S: Final = 0.5
NOT_STOPPED: Final = "The emergency stop was NOT confirmed: switch the servos' power off."
"""Somebody pressed it, and has to know at the end that nobody answered."""
_READ: Final = 4096
"""All that a terminal keeps: keys that were pressed while this program could not run count as one reading."""


class Screen(ABC):
    """Shown by `show`, until a key, a signal or a fault ends it."""

    def __init__(self) -> None:
        self.changed = threading.Event()
        """Set by whoever wants it drawn soon."""
        self.failures: list[str] = []
        """Sentences. Where drawing fails, it ends: an old picture must not pass for the present state."""
        self._ended = threading.Event()
        self._wake = -1
        # The terminal's own size: what a shell has exported of it is not that of a window that was made smaller since.
        environ = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
        self._console = Console(_environ=environ)
        self._live = Live(console=self._console, screen=True, auto_refresh=False, redirect_stderr=False)
        self._drawer = threading.Thread(target=self._draw, name="draw", daemon=True)

    @abstractmethod
    def begin(self) -> None:
        """Before the first picture. Waits for nothing."""

    @abstractmethod
    def press(self, keys: list[str]) -> bool:
        """Act on what one reading gave; whether to go on. Waits for nothing."""

    @abstractmethod
    def picture(self, columns: int, rows: int) -> Text:
        """What is shown now; on the thread that draws."""

    @abstractmethod
    def end(self) -> None:
        """It ends: make the robot safe, and let go of it. It is still drawn meanwhile. Raises GatewayError."""

    def last_words(self) -> list[str]:
        """What a person is to know once the screen is gone."""
        return []

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
            if not data or not self.press(keyboard.keys(data, time.monotonic())):
                return
            self.changed.set()

    def _draw(self) -> None:
        try:
            with self._live:
                while not self._ended.is_set():
                    self.changed.clear()
                    # Shown without any lock: this waits for the terminal.
                    self._live.update(self.picture(*self._console.size), refresh=True)
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
