"""The terminal of `watch`: keys on the calling thread, drawing on another."""

import os
import select
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime
from typing import Final

from rich.console import Console
from rich.live import Live

from gateway.people.client.blocking import Client
from gateway.people.tools.keyboard import keys_at_once, wake_on_signals
from gateway.people.tools.watch.link import Link
from gateway.people.tools.watch.model import Model
from gateway.people.tools.watch.view import picture

FRAME_S: Final = 0.1
"""Ages count up between two states, so it draws ten times a second."""
LEAST_FRAME_S: Final = 0.03
"""Shortest time between two pictures, however much happens: drawing must not load the robot's computer."""
DRAWER_END_S: Final = 0.5

STOP_KEYS: Final = frozenset(b" eE")
_INTERRUPT: Final = 3


class Watch:
    """One view; `run` shows it until q."""

    def __init__(
        self, connect: Callable[[], Client], where: str, why: Callable[[], list[str]], own_expiry: str | None
    ) -> None:
        self._model = Model(own_expiry=own_expiry)
        self._lock = threading.Lock()
        self._where = where
        self._news = threading.Event()
        self._ended = threading.Event()
        self.fault: Exception | None = None
        """Why drawing failed. The view then ends, since an old picture must not pass for the present state."""
        self._wake = -1
        self._link = Link(connect, self._model, self._lock, self._news.set, why)
        self._console = Console()
        self._live = Live(console=self._console, screen=True, auto_refresh=False, redirect_stderr=False)
        self._drawer = threading.Thread(target=self._draw, name="draw", daemon=True)

    @property
    def unconfirmed_stop(self) -> bool:
        """Whether somebody pressed the emergency stop and nobody has confirmed it."""
        return self._model.stop_wanted_ns is not None

    def run(self) -> None:
        """Show it until q, a signal or a fault, and let go within a second."""
        with keys_at_once(sys.stdin.fileno()), wake_on_signals() as (woken, wake):
            self._wake = wake
            self._link.start()
            self._drawer.start()
            self._read_keys(sys.stdin.fileno(), woken)
            self._ended.set()
            self._news.set()
            self._link.close()
            self._drawer.join(DRAWER_END_S)

    # ---- keys

    def _read_keys(self, terminal: int, woken: int) -> None:
        while True:
            ready, _, _ = select.select([terminal, woken], [], [])
            if woken in ready:
                return
            try:
                pressed = os.read(terminal, 64)
            except OSError:  # the terminal is gone
                return
            if not pressed or not self._press(pressed):
                return

    def _press(self, pressed: bytes) -> bool:
        """Act on what was typed; whether to go on. A stop among it comes first, whatever else there is."""
        if STOP_KEYS & set(pressed):
            self._link.stop()
            return True
        if pressed.startswith(b"\x1b"):  # an arrow key, a mouse: bytes that are no letters
            return True
        for key in pressed.lower():
            if key in (ord("q"), _INTERRUPT):
                return False
            self._press_key(chr(key))
            self._news.set()
        return True

    def _press_key(self, key: str) -> None:
        now_ns = time.monotonic_ns()
        with self._lock:
            asking, taking = self._model.asking(now_ns), self._model.asking_to_take(now_ns)
            drives = self._model.drives
            if asking and key != "y":
                self._model.reset_declined(now_ns)
            elif taking and key != "y":
                self._model.take_declined(now_ns)
            elif key == "r":
                self._model.reset_pressed(now_ns)
            elif key == "t" and not drives:
                self._model.take_pressed(now_ns)
        match key:
            case "y" if asking:
                self._link.reset()
            case "y" if taking:
                self._link.lease.take()
            case "a" if not (asking or taking):
                self._link.lease.ask()
            case "t" if drives and not (asking or taking):
                self._link.lease.release()

    # ---- drawing

    def _draw(self) -> None:
        try:
            self._draw_until_the_end()
        except Exception as error:
            self.fault = error
            os.write(self._wake, b".")

    def _draw_until_the_end(self) -> None:
        with self._live:
            while not self._ended.is_set():
                self._news.clear()
                width, height = self._console.size
                now_ns = time.monotonic_ns()
                with self._lock:
                    self._model.look(now_ns, datetime.now().astimezone())
                    text = picture(self._model, now_ns, self._where, width, height)
                self._live.update(text, refresh=True)  # waits for the terminal, and so without the lock
                self._ended.wait(LEAST_FRAME_S)
                self._news.wait(FRAME_S - LEAST_FRAME_S)
