"""The one servo that `calibrate` moves: started alone, kept running while somebody sits at the keys, stopped."""

import threading
import time
from typing import Final

from gateway.client import Client
from gateway.errors import GatewayError, RejectedError
from schemas.telemetry import Ack

PERIOD_S: Final = 0.05
UNSEEN_S: Final = 1.0
"""A screen that did not turn for so long is stuck, or its link is, and nobody sees the servo's angle any more. Then
nothing is repeated, and the gateway's watchdog stops the servo."""


class Held:
    """Repeats the newest angle of one servo, on a thread. `fault` says why it stopped doing so."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._lock = threading.Lock()
        self._target: tuple[int, float] | None = None
        self._seen_s = time.monotonic()
        self._ended = threading.Event()
        self.fault: str | None = None
        self._thread = threading.Thread(target=self._repeat, name="hold", daemon=True)
        self._thread.start()

    def start(self, servo_id: int, angle_deg: float) -> None:
        """Energise it. Raises GatewayError where the gateway does not."""
        _accepted(self._client.servo(servo_id, "start", angle_deg))
        with self._lock:
            self._target, self.fault = (servo_id, angle_deg), None

    def go(self, angle_deg: float) -> None:
        """The angle from now on."""
        with self._lock:
            if self._target is not None:
                self._target = (self._target[0], angle_deg)

    @property
    def running(self) -> bool:
        """Whether a servo is kept running."""
        return self._target is not None

    def seen(self) -> None:
        """The screen has turned: somebody can see what happens."""
        self._seen_s = time.monotonic()

    def stop(self) -> None:
        """Stop the leg, and repeat nothing any more. Raises GatewayError where nobody confirms it."""
        with self._lock:
            target, self._target = self._target, None
        if target is not None:
            _accepted(self._client.stop(target[0] // 10))

    def close(self) -> None:
        """As `stop`, for good."""
        self._ended.set()
        self.stop()

    def _repeat(self) -> None:
        while not self._ended.wait(PERIOD_S):
            with self._lock:  # held while it asks, so that no set is on its way when `stop` sends its Stop
                if self._target is None:
                    continue
                try:
                    if time.monotonic() - self._seen_s > UNSEEN_S:
                        raise GatewayError("this terminal was stuck, so the servo was not held any more")
                    _accepted(self._client.servo(self._target[0], "set", self._target[1]))
                except GatewayError as error:
                    self.fault, self._target = str(error), None


def _accepted(ack: Ack) -> None:
    if not ack.accepted:
        raise RejectedError(str(ack.reason), ack.detail or "no reason was given")
