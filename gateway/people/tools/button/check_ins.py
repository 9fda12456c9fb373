"""A button's check-ins, one after the other, by the clock."""

import threading
import time
from collections.abc import Callable

from gateway.errors import GatewayError, RejectedError
from gateway.people.client.button import Button
from gateway.people.tools.button.known import Known, is_taken
from schemas.telemetry import Reason


class CheckIns(Known):
    """Checks in on a thread of its own, while the person can see and press."""

    def __init__(self, button: Button, lives: Callable[[], bool], uptime_s: Callable[[], float]) -> None:
        """`lives`: whether the person can see and press now. `uptime_s`: of the gateway; may raise GatewayError."""
        super().__init__(time.monotonic())
        self._button = button
        self._lives = lives
        self._uptime_s = uptime_s
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="check in", daemon=True)

    def start(self) -> None:
        """Begin to check in."""
        self._thread.start()

    def end(self) -> None:
        """End the check-ins, and leave. Raises ZenohError."""
        self._ended.set()
        self._thread.join(self.timeout_ms / 1000 or None)
        if not self._thread.is_alive():
            self._button.leave()

    @property
    def timeout_ms(self) -> float:
        """How long a check-in counts."""
        return self._button.timeout_ms

    @property
    def silent_ms(self) -> float:
        """Since the gateway last took a check-in."""
        return self.silence_s(time.monotonic()) * 1000

    @property
    def is_counted(self) -> bool:
        """Whether the gateway counts this button, as far as it has answered."""
        return self.counts(time.monotonic(), self.timeout_ms / 1000)

    def _run(self) -> None:
        while not self._ended.is_set() and not self.refused:
            began_s = time.monotonic()
            if self._lives():
                try:
                    self._check_in(began_s)
                except (GatewayError, RuntimeError) as error:
                    self.failed(str(error), denied=isinstance(error, RejectedError))
            self._ended.wait(max(0.0, self.next_s(began_s, self.timeout_ms / 1000) - time.monotonic()))

    def _check_in(self, began_s: float) -> None:
        try:
            ack = self._button.alive()
        except RejectedError as error:
            self._register_anew(error)
        else:
            self.accepted((ack.alive or 0, ack.required or 0), ack.detail or "", began_s, time.monotonic())

    def _register_anew(self, error: RejectedError) -> None:
        """After a restart of the gateway, or where this machine's clock stood still."""
        self.failed(str(error), denied=True)
        taken = error.reason == Reason.UNKNOWN_BUTTON and is_taken(
            self._uptime_s(), self._button.registered_s, time.monotonic()
        )
        if taken:
            self.refused = f"another button has registered as {self._button.name}, or taken its place"
        else:
            self._button.register()
            self.registered()
