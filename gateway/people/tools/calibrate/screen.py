"""The terminal of `calibrate`: keys on the calling thread, drawing on another. Neither waits for the gateway."""

import os
import select
import sys
import threading
import time
from typing import Final

from rich.console import Console
from rich.live import Live

from gateway.errors import LeaseLostError
from gateway.people.client.blocking import Client
from gateway.people.tools.calibrate.guide import Guide
from gateway.people.tools.calibrate.held_servo import HeldServo
from gateway.people.tools.calibrate.robot import Robot
from gateway.people.tools.calibrate.session import Session
from gateway.people.tools.calibrate.view import picture
from gateway.people.tools.keyboard import Keyboard, keys_at_once, wake_on_signals
from gateway.robot.core.calibration import Calibration

FRAME_S: Final = 0.1
LEAST_FRAME_S: Final = 0.03
"""Shortest time between two pictures, however much happens."""
DRAWER_END_S: Final = 0.5
STOP_S: Final = 2.5
"""How long the end waits for the Stop to be confirmed: longer than a client does, with its timeout of 2 s."""
_READ: Final = 4096
"""All that a terminal keeps: keys that were pressed while this program could not run count as one reading."""


class Screen:
    """One walk through the guide; `run` shows it until somebody leaves."""

    def __init__(
        self,
        client: Client,
        calibration: Calibration,
        timeout_ms: float,
        where: str,
        avoid_cdeg: tuple[int, int] | None = None,
    ) -> None:
        """`timeout_ms` is the gateway's `watchdog.timeout_ms`; `where` is what the title says of the robot.

        `avoid_cdeg`: angles that the gateway never sends; keys move over them.
        """
        self._where = where
        self._news = threading.Event()
        self._ended = threading.Event()
        self._wake = -1
        self.held = HeldServo(client, timeout_ms)
        self.robot = Robot(client, self._lost)
        self.session = Session(Guide(calibration, avoid_cdeg), self.held, self.robot, self._news.set)
        self.fault: Exception | None = None
        """Why drawing failed; the servo is stopped then, since nobody sees it."""
        self.stopped = True
        """Whether the Stop at the end was confirmed, if one was needed."""
        self._console = Console()
        self._live = Live(console=self._console, screen=True, auto_refresh=False, redirect_stderr=False)
        self._drawer = threading.Thread(target=self._draw, name="draw", daemon=True)

    def run(self) -> bool:
        """Show it until q, a signal or a fault. The servo is stopped first, then all else is let go of.

        Returns whether the terminal takes text again: one that is stuck does not.
        """
        terminal = sys.stdin.fileno()
        with keys_at_once(terminal), wake_on_signals() as (woken, wake):
            self._wake = wake
            self._drawer.start()
            try:
                self._read_keys(terminal, woken)
            finally:
                self.stopped = self.held.close(STOP_S)
                self._ended.set()
                self._news.set()
                self.robot.release()
                self._drawer.join(DRAWER_END_S)
        return not self._drawer.is_alive()

    def _lost(self, error: LeaseLostError) -> None:
        self.session.lost(error)

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
            if not data or not self._press(keyboard.keys(data, time.monotonic())):
                return
            self._news.set()

    def _press(self, keys: list[str]) -> bool:
        """Act on what was pressed; whether to go on. A Stop among it is all that counts."""
        for stop in (" ", "ctrl-c"):
            if stop in keys:
                return self.session.press(stop)
        return all(self.session.press(key, alone=len(keys) == 1) for key in keys)

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
                columns, rows = self._console.size
                with self.session.lock:
                    self.session.turn()
                    text = picture(self.session, self._where, rows, columns)
                self._live.update(text, refresh=True)  # waits for the terminal, and so without the lock
                self._ended.wait(LEAST_FRAME_S)
                self._news.wait(FRAME_S - LEAST_FRAME_S)
