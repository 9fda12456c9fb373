"""The one servo that `calibrate` moves: started alone, kept running while somebody sits at the keys, stopped.

Nothing that a key does waits for the gateway. One thread starts the servo and repeats its newest angle; each Stop has a
thread of its own, and so waits for no answer to an earlier request.
"""

import threading
import time
from dataclasses import dataclass, replace
from typing import Final

import zenoh

from gateway.errors import GatewayError, LeaseLostError
from gateway.people.client.blocking import Client
from gateway.text import visible
from schemas.telemetry import Ack, Reason

PERIOD_S: Final = 0.05
"""At most; at least five times in each of the gateway's watchdog timeouts."""
UNSEEN_S: Final = 1.0
"""A screen that did not turn for so long is stuck, and nobody sees the servo's angle any more: the servo is stopped."""
UNTOUCHED_S: Final = 120.0
"""Without a key for so long, nobody is there (or the SSH connection is gone): the servo is stopped. Measuring an angle
takes less."""
STOPS_AT_ONCE: Final = 4
"""Stops under way at most; a key that is held down repeats some 30 times a second."""

_ERRORS: Final = (GatewayError, zenoh.ZError, RuntimeError)
_STOPPED: Final = (Reason.SERVO_STOPPED, Reason.ESTOPPED)
"""Rejections that say that the servo does not run."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What the servo is to do. Another servo, and each start, is another `number`."""

    number: int
    servo_id: int
    op: str
    angle_deg: float


class HeldServo:
    """Repeats the newest angle of one servo. `fault` states why it stopped doing so."""

    def __init__(self, client: Client, timeout_ms: float = 250.0) -> None:
        """`timeout_ms` is the gateway's `watchdog.timeout_ms`."""
        self._client = client
        self._period_s = min(PERIOD_S, timeout_ms / 5000)
        self._lock = threading.Lock()
        """Held for moments only, never while something is asked."""
        self._news = threading.Event()
        self._ended = False
        self._wanted: _Wanted | None = None
        self._confirmed_deg: float | None = None
        self._number = 0
        self._started_leg: int | None = None
        """The leg whose Stop somebody has yet to confirm."""
        self._stops = 0
        self._starting = False
        """A start is on its way, and has not been answered."""
        self._stopped = threading.Condition(self._lock)
        self._answered_s = self._seen_s = self._touched_s = time.monotonic()
        self.fault: str | None = None
        self.has_run = False
        """Whether the gateway confirmed the latest start."""
        self.unconfirmed: str | None = None
        """Why the last Stop was not confirmed."""
        self._rejected: tuple[str, float] | None = None
        threading.Thread(target=self._repeat, name="hold", daemon=True).start()

    # ---- for the keys; none of these waits

    def start(self, servo_id: int, angle_deg: float) -> None:
        """Energise it, and keep it there."""
        with self._lock:
            self._number += 1
            self._wanted = _Wanted(self._number, servo_id, "start", angle_deg)
            self._confirmed_deg, self.fault, self._rejected, self.unconfirmed = None, None, None, None
            self._started_leg, self.has_run = servo_id // 10, False
            self._answered_s = self._seen_s = self._touched_s = time.monotonic()
        self._news.set()

    def go(self, angle_deg: float) -> bool:
        """Move there; false, and nothing happens, while the gateway has yet to confirm the angle before.

        So nothing piles up, however fast a key repeats: when it is released, one step is under way at most.
        """
        with self._lock:
            if self._wanted is None or self._confirmed_deg != self._wanted.angle_deg:
                return False
            self._wanted = replace(self._wanted, angle_deg=angle_deg)
        self._news.set()
        return True

    def stop(self, *, all_legs: bool = False) -> None:
        """Stop the leg, if it was started, or all six, and repeat nothing any more."""
        with self._lock:
            leg = None if all_legs else self._started_leg
            self._drop(None)
            if (leg is None and not all_legs) or self._stops >= STOPS_AT_ONCE:
                return
            self._stops += 1
        threading.Thread(target=self._stop, args=(leg,), name="stop", daemon=True).start()

    def forget(self) -> None:
        """Somebody else drives, who stopped all legs: the leg is theirs, and a Stop of ours would be wrong."""
        with self._lock:
            self._drop(None)
            self._started_leg = None

    def touched(self) -> None:
        """A key was pressed."""
        self._touched_s = time.monotonic()

    def seen(self) -> None:
        """The screen has turned: somebody can see what happens."""
        self._seen_s = time.monotonic()

    @property
    def running(self) -> bool:
        """Whether a servo is kept running, or is about to be started."""
        return self._wanted is not None

    @property
    def confirmed(self) -> bool:
        """Whether the gateway has confirmed that it runs."""
        return self._confirmed_deg is not None and self._wanted is not None

    @property
    def stopping(self) -> bool:
        """Whether a Stop is on its way, or a start that will get one."""
        return self._stops > 0 or (self._starting and self._wanted is None)

    @property
    def unanswered_s(self) -> float:
        """For how long the gateway has not answered."""
        return time.monotonic() - self._answered_s if self._wanted is not None else 0.0

    def rejected_step(self) -> tuple[str, float] | None:
        """Why the gateway rejected a step since the last call, and the angle where the servo stayed."""
        with self._lock:
            found, self._rejected = self._rejected, None
            return found

    def close(self, wait_s: float) -> bool:
        """Stop the leg for good; whether that was confirmed within `wait_s`, or nothing had been started."""
        self._ended = True
        self.stop()
        self._news.set()
        with self._stopped:
            return self._stopped.wait_for(lambda: self._started_leg is None and not self._starting, wait_s)

    # ---- threads

    def _repeat(self) -> None:
        while not self._ended:
            self._news.wait(self._period_s if self._wanted is not None else None)
            self._news.clear()
            wanted = self._wanted
            if wanted is None:
                continue
            now_s = time.monotonic()
            if now_s - self._seen_s > UNSEEN_S:
                self._give_up(wanted, "this terminal was stuck, so the servo was stopped")
            elif now_s - self._touched_s > UNTOUCHED_S:
                self._give_up(wanted, f"no key was pressed for {UNTOUCHED_S / 60:g} minutes, so the servo was stopped")
            else:
                self._ask(wanted)

    def _ask(self, wanted: _Wanted) -> None:
        fault, ack, theirs = "", None, False
        self._starting = wanted.op == "start"
        try:
            ack = self._client.servo(wanted.servo_id, wanted.op, wanted.angle_deg)
        except _ERRORS as error:
            fault = visible(str(error))
            theirs = isinstance(error, LeaseLostError) and error.holder is not None
        with self._lock:
            overtaken = self._wanted is None or self._wanted.number != wanted.number
            if not overtaken and ack is not None and self._judged(wanted, ack):
                self._starting = False
                return
            if not overtaken:
                self._drop(fault or _rejection(ack))
                if theirs or (ack is not None and (self._starting or ack.reason in _STOPPED)):
                    self._confirm_stop()
        rejected = ack is not None and not ack.accepted
        if overtaken and self._starting and not rejected:  # its Stop may have come before it
            self._stop(wanted.servo_id // 10, counted=False)
        elif not overtaken:
            self.stop()  # where nobody has reported that the servo does not run
        with self._lock:
            self._starting = False
            self._stopped.notify_all()

    def _judged(self, asked: _Wanted, ack: Ack) -> bool:
        """Take notice of an answer to what is still wanted; whether the servo goes on."""
        current = self._wanted or asked
        self._answered_s = time.monotonic()
        if ack.accepted:
            self._confirmed_deg, self.has_run = asked.angle_deg, True
            self._wanted = replace(current, op="set")
            return True
        if ack.reason == Reason.JOINT_LIMIT and asked.op == "set" and self._confirmed_deg is not None:
            self._wanted = replace(current, angle_deg=self._confirmed_deg)
            self._rejected = (visible(ack.detail or "the gateway has a limit there"), self._confirmed_deg)
            self._news.set()  # at once: what was rejected has not fed the watchdog
            return True
        return False

    def _give_up(self, wanted: _Wanted, fault: str) -> None:
        with self._lock:
            if self._wanted is None or self._wanted.number != wanted.number:
                return
            self._drop(fault)
        self.stop()

    def _drop(self, fault: str | None) -> None:
        """Repeat nothing any more."""
        self._wanted, self._confirmed_deg = None, None
        self.fault = fault or self.fault

    def _stop(self, leg: int | None, *, counted: bool = True) -> None:
        unconfirmed: str | None = None
        try:
            ack = self._client.stop(leg)
            if not ack.accepted and ack.reason not in _STOPPED:
                unconfirmed = _rejection(ack)
        except _ERRORS as error:
            unconfirmed = visible(str(error))
        with self._lock:
            self._stops -= counted
            if self._wanted is None:  # and nothing has been started since
                self.unconfirmed = unconfirmed
                if unconfirmed is None:
                    self._confirm_stop()

    def _confirm_stop(self) -> None:
        self._started_leg = None
        self._stopped.notify_all()


def _rejection(ack: Ack | None) -> str:
    return "" if ack is None else visible(f"{ack.reason}: {ack.detail or 'no reason was given'}")
