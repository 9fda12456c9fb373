"""The one servo that `calibrate` moves: started alone, kept running while somebody sits at the keys, stopped.

Nothing that a key does waits for the gateway. One thread starts the servo and repeats its newest angle; others, which
exist from the beginning, request its Stop. What they do is decided in `Holding` and `ConfirmedStop`.
"""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import zenoh

from gateway.errors import GatewayError, LeaseLostError, RejectedError
from gateway.people.client.blocking import Client
from gateway.people.client.stops import UntilConfirmed
from gateway.people.tools.calibrate.holding import ALL_LEGS, STOPPED, Holding, Wanted
from gateway.text import visible
from schemas.telemetry import Ack

PERIOD_S: Final = 0.05
"""At most; at least five times in each of the gateway's watchdog timeouts."""
STOP_LASTS_S: Final = 2.0
"""For so long a Stop is requested again: later, the leg may be somebody else's. The watchdog has stopped it by then."""

_ERRORS: Final = (GatewayError, zenoh.ZError, RuntimeError)


class HeldServo:
    """Repeats the newest angle of one servo."""

    def __init__(self, client: Client, timeout_ms: float = 250.0) -> None:
        """`timeout_ms` is the gateway's `watchdog.timeout_ms`."""
        self._client = client
        self._period_s = min(PERIOD_S, timeout_ms / 5000)
        self.holding = Holding(time.monotonic())
        """To look at."""
        self._stopped = threading.Condition(threading.Lock())
        """Its lock is held for moments only, never while something is asked."""
        self._news = threading.Event()
        self._ended = False
        self._stops = UntilConfirmed(self._stop, self._stop_ended, STOP_LASTS_S)
        threading.Thread(target=self._repeat, name="hold", daemon=True).start()

    # ---- for the keys; none of these waits

    def start(self, servo_id: int, angle_deg: float) -> None:
        """Energise it, and keep it there."""
        self._stops.take_back()
        with self._changes() as holding:
            holding.start(servo_id, angle_deg, time.monotonic())
        self._news.set()

    def go(self, angle_deg: float) -> bool:
        """Move there; false, and nothing happens, while the gateway has yet to confirm the angle before."""
        with self._changes() as holding:
            goes = holding.go(angle_deg)
        self._news.set()
        return goes

    def stop(self, *, all_legs: bool = False) -> None:
        """Stop the leg, if it was started, or all six, and repeat nothing any more."""
        with self._changes() as holding:
            holding.stop(all_legs=all_legs)

    def forget(self) -> None:
        """Somebody else drives, who stopped all legs."""
        self._stops.take_back()
        with self._changes() as holding:
            holding.forget()

    def touched(self) -> None:
        """A key was pressed."""
        self.holding.touched(time.monotonic())

    def seen(self) -> None:
        """The screen has turned: somebody can see what happens."""
        self.holding.seen(time.monotonic())

    @property
    def stopping(self) -> bool:
        """Whether a Stop is on its way, or a start that will get one."""
        with self._stopped:
            return self._stops.since_ns is not None or self.holding.start_is_overtaken

    @property
    def unanswered_s(self) -> float:
        """For how long the gateway has not answered."""
        return self.holding.unanswered_s(time.monotonic())

    def rejected_step(self) -> tuple[str, float] | None:
        """Why the gateway rejected a step since the last call, and the angle where the servo stayed."""
        with self._changes() as holding:
            return holding.rejected_step()

    def close(self, wait_s: float) -> bool:
        """Stop the leg for good; whether that was confirmed within `wait_s`, or nothing had been started."""
        self._ended = True
        self.stop()
        self._news.set()
        with self._stopped:
            return self._stopped.wait_for(lambda: self.holding.is_stopped, wait_s)

    # ---- threads

    @contextmanager
    def _changes(self) -> Iterator[Holding]:
        with self._stopped:
            yield self.holding
            if self.holding.takes_stop():
                self._stops.press()
            self._stopped.notify_all()

    def _repeat(self) -> None:
        while not self._ended:
            self._news.wait(self._period_s if self.holding.wanted else None)
            self._news.clear()
            with self._changes() as holding:
                wanted = holding.look(time.monotonic())
            if wanted is not None:
                self._ask(wanted)

    def _ask(self, wanted: Wanted) -> None:
        try:
            ack = self._client.servo(wanted.servo_id, wanted.op, wanted.angle_deg)
        except _ERRORS as error:
            theirs = isinstance(error, LeaseLostError) and error.holder is not None
            with self._changes() as holding:
                holding.failed(wanted, visible(str(error)), theirs=theirs)
            return
        with self._changes() as holding:
            at_once = holding.answered(wanted, ack, time.monotonic())
        if at_once:
            self._news.set()

    def _stop(self) -> Ack:
        with self._stopped:
            owed = self.holding.owed
        if owed is None:
            return Ack(accepted=True)
        ack = self._client.stop(None if owed == ALL_LEGS else owed)
        if not ack.accepted and ack.reason not in STOPPED:
            raise RejectedError(str(ack.reason), ack.detail or "no reason was given")
        return ack

    def _stop_ended(self, outcome: Ack | Exception) -> bool:
        with self._changes() as holding:
            unconfirmed = None if isinstance(outcome, Ack) else visible(str(outcome) or repr(outcome))
            holding.stop_ended(unconfirmed, more=unconfirmed is None and self._stops.since_ns is not None)
        return True
