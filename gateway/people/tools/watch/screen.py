"""What `watch` does with each key, and what it draws."""

import threading
import time
from collections.abc import Callable
from datetime import datetime
from typing import Final

from rich.text import Text

from gateway.people.client.blocking import Client
from gateway.people.terminal.screen import Screen
from gateway.people.tools.watch.link import Link
from gateway.people.tools.watch.model import Model, Question
from gateway.people.tools.watch.view import picture

STOP_KEYS: Final = frozenset(" eE")
_NO_KEYS: Final = frozenset({"escape", "up", "down", "left", "right"})


class Watch(Screen):
    """One view; shown until q."""

    def __init__(
        self, connect: Callable[[], Client], where: str, why: Callable[[], list[str]], own_expiry: str | None
    ) -> None:
        super().__init__()
        self._model = Model(own_expiry=own_expiry)
        self._lock = threading.Lock()
        self._where = where
        self._link = Link(connect, self._model, self._lock, self.changed.set, why)

    @property
    def unconfirmed_stop(self) -> bool:
        """Whether somebody pressed the emergency stop and nobody has confirmed it."""
        return self._model.stop_wanted_ns is not None

    def begin(self) -> None:
        self._link.start()

    def end(self) -> None:
        """The robot goes on: nothing here moves it."""
        self._link.close()

    def press(self, keys: list[str]) -> bool:
        """A stop among them comes first, whatever else there is."""
        if STOP_KEYS & set(keys):
            self._link.stop()
            return True
        for key in keys:
            if key in ("q", "Q", "ctrl-c"):
                return False
            if key not in _NO_KEYS:
                self._press(key.lower())
        return True

    def _press(self, key: str) -> None:
        now_ns = time.monotonic_ns()
        with self._lock:
            asking, drives = self._model.asking(now_ns), self._model.drives
            if asking is not None and key != "y":
                self._model.declined(now_ns)
            elif key == "r":
                self._model.ask(Question.RESET, now_ns)
            elif key == "t" and not drives:
                self._model.ask(Question.TAKE, now_ns)
        match asking, key:
            case Question.RESET, "y":
                self._link.reset()
            case Question.TAKE, "y":
                self._link.lease.take()
            case None, "a":
                self._link.lease.ask()
            case None, "t" if drives:
                self._link.lease.release()

    def picture(self, columns: int, rows: int) -> Text:
        now_ns = time.monotonic_ns()
        with self._lock:
            self._model.look(now_ns, datetime.now().astimezone())
            return picture(self._model, now_ns, self._where, columns, rows)
