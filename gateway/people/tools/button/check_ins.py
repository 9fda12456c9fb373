"""A button's check-ins, one after the other, and what is known of them."""

import threading
import time
from collections.abc import Callable
from typing import Final

from gateway.errors import GatewayError, RejectedError
from gateway.people.client.button import Button
from schemas.telemetry import Reason

SHARE: Final = 4
"""Check-ins within the time that one of them counts: three may be lost on the way."""
AGAIN_S: Final = 0.2
"""After one that nobody answered."""
DENIED_S: Final = 1.0
"""After a registration that was rejected: each costs the gateway a proof to check."""
LATE: Final = 0.25
"""Of the time that one counts: an answer that takes longer comes late, as the person should know."""


class CheckIns:
    """Checks in, on a thread of its own, as long as the person's end of the program lives."""

    def __init__(self, button: Button, lives: Callable[[], bool], uptime_s: Callable[[], float]) -> None:
        """`lives`: whether the person can see and press now. `uptime_s`: of the gateway; may raise GatewayError."""
        self._button = button
        self._lives = lives
        self._uptime_s = uptime_s
        self._ended = threading.Event()
        self.count = (0, 0)
        """How many are alive, and how many are required, by the latest answer."""
        self.detail = ""
        """What the latest answer says besides."""
        self._answer_s = 0.0
        """How long it took."""
        self.trouble = ""
        """Why the latest was not accepted."""
        self.refused = ""
        """Why no more check-ins are sent. Pressing goes on."""
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

    @property
    def late_ms(self) -> float | None:
        """How long the latest answer took, if it came late."""
        return self._answer_s * 1000 if self._answer_s * 1000 > LATE * self.timeout_ms else None

    def _run(self) -> None:
        while not self._ended.is_set() and not self.refused:
            began_s = time.monotonic()
            pause_s = self.timeout_ms / 1000 / SHARE
            if self._lives():
                try:
                    self._check_in()
                except (GatewayError, RuntimeError) as error:
                    self.trouble = str(error)
                    pause_s = DENIED_S if isinstance(error, RejectedError) else AGAIN_S
            self._ended.wait(max(0.0, began_s + pause_s - time.monotonic()))

    def _check_in(self) -> None:
        began_s = time.monotonic()
        try:
            ack = self._button.alive()
        except RejectedError as error:
            self._register_anew(error)
            return
        self.count, self.detail = (ack.alive or 0, ack.required or 0), ack.detail or ""
        self._answer_s = time.monotonic() - began_s
        self.confirmed_s, self.trouble = began_s, ""

    def _register_anew(self, error: RejectedError) -> None:
        """After a restart of the gateway, or where this machine's clock stood still. Not against another of the name:
        it has the same certificate, and the two would take the place from each other for ever."""
        self.trouble = str(error)
        since_s = time.monotonic() - self._button.registered_s
        if error.reason == Reason.UNKNOWN_BUTTON and self._uptime_s() > since_s:
            self.refused = f"another button has registered as {self._button.name}, or taken its place"
            return
        self._button.register()
