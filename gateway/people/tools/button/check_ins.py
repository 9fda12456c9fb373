"""A button's check-ins, one after the other, and what is known of them."""

import threading
import time
from collections.abc import Callable
from typing import Final

from gateway.errors import ConfigError, GatewayError, RejectedError
from gateway.people.client.button import Button
from schemas.telemetry import Reason

SHARE: Final = 4
"""Check-ins within the time that one of them counts: three may be lost on the way."""
AGAIN_S: Final = 0.2
"""After one that nobody answered, or that was rejected."""


class CheckIns:
    """Checks in, on a thread of its own, as long as the person's end of the program lives."""

    def __init__(self, button: Button, lives: Callable[[], bool], uptime_s: Callable[[], float]) -> None:
        """`lives`: whether the person can see and press now. `uptime_s`: of the gateway; may raise GatewayError."""
        self._button = button
        self._lives = lives
        self._uptime_s = uptime_s
        self._registered_s = time.monotonic()
        self._ended = threading.Event()
        self.count = (0, 0)
        """How many are alive, and how many are required, by the latest answer."""
        self.trouble = ""
        """Why the latest was not accepted."""
        self.refused = ""
        """Why it is over."""
        self.confirmed_s = time.monotonic()
        """When the latest that was accepted was sent, monotonic."""
        self._thread = threading.Thread(target=self._run, name="check in", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def end(self) -> None:
        """Check in no more, and leave."""
        self._ended.set()
        self._thread.join(self.timeout_ms / 1000 or None)
        if not self._thread.is_alive():
            self._button.leave()

    @property
    def timeout_ms(self) -> float:
        """For so long one counts."""
        return self._button.timeout_ms

    @property
    def silent_ms(self) -> float:
        """Since the gateway last took a check-in."""
        return (time.monotonic() - self.confirmed_s) * 1000

    @property
    def heard(self) -> bool:
        """Whether the gateway counts this button, as far as it has answered."""
        return not self.refused and not self.trouble and self.silent_ms < self.timeout_ms

    def _run(self) -> None:
        while not self._ended.is_set() and not self.refused:
            began_s = time.monotonic()
            pause_s = self.timeout_ms / 1000 / SHARE
            if self._lives():
                try:
                    self._check_in()
                except (GatewayError, RuntimeError) as error:
                    self.trouble, pause_s = str(error), AGAIN_S
            self._ended.wait(max(0.0, began_s + pause_s - time.monotonic()))

    def _check_in(self) -> None:
        began_s = time.monotonic()
        try:
            ack = self._button.alive()
        except RejectedError as error:
            self._register_anew(error)
            return
        self.count = ack.alive or 0, ack.required or 0
        self.confirmed_s, self.trouble = began_s, ""

    def _register_anew(self, error: RejectedError) -> None:
        """After a restart of the gateway, or where this machine's clock stood still. Not against another of the name:
        the two would take it from each other for ever, and the robot would stop each time."""
        self.trouble = str(error)
        since_s = time.monotonic() - self._registered_s
        if error.reason == Reason.UNKNOWN_BUTTON and self._uptime_s() > since_s:
            self.refused = f"another button has registered as {self._button.name}, or taken its place"
            return
        try:
            self._button.register()
            self._registered_s = time.monotonic()
        except (RejectedError, ConfigError) as denied:
            self.refused = str(denied)
