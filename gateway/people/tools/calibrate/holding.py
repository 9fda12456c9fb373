"""The rules of the one servo that `calibrate` moves: what is asked for it, and when it is owed a Stop.

Nothing here reads a clock or waits: `now_s` is monotonic, and what happens comes in. After each change `takes_stop`
says whether a Stop is to be requested now.
"""

from dataclasses import dataclass, replace
from typing import Final

from gateway.text import visible
from schemas.telemetry import Ack, Reason

UNSEEN_S: Final = 1.0
"""A screen that did not turn for so long is stuck, and nobody sees the servo's angle any more: the servo is stopped."""
UNTOUCHED_S: Final = 120.0
"""Without a key for so long, nobody is there (or the SSH connection is gone): the servo is stopped. Measuring an angle
takes less."""
ALL_LEGS: Final = 0

STOPPED: Final = (Reason.SERVO_STOPPED, Reason.ESTOPPED)
"""Rejections that say that the servo does not run."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the servo is to do. Another servo, and each start, is another `number`."""

    number: int
    servo_id: int
    op: str
    angle_deg: float


class Holding:
    """What one servo is to do; `fault` states why it is repeated no more."""

    def __init__(self, now_s: float) -> None:
        self.wanted: Wanted | None = None
        self.fault: str | None = None
        self.has_run = False
        """Whether the gateway confirmed the latest start."""
        self.unconfirmed: str | None = None
        """Why the last Stop was not confirmed."""
        self._confirmed_deg: float | None = None
        self._rejected: tuple[str, float] | None = None
        self._number = 0
        self._owed: int | None = None
        """The leg whose Stop somebody has yet to confirm, ALL_LEGS, or None."""
        self._stop_due = False
        self._starting = False
        """A start is on its way, and has not been answered."""
        self._answered_s = self._seen_s = self._touched_s = now_s

    # ---- what the person does

    def start(self, servo_id: int, angle_deg: float, now_s: float) -> None:
        """Energise it, and keep it there."""
        self._number += 1
        self.wanted = Wanted(self._number, servo_id, "start", angle_deg)
        self._confirmed_deg, self.fault, self._rejected, self.unconfirmed = None, None, None, None
        self._owed, self.has_run = servo_id // 10, False
        self._answered_s = self._seen_s = self._touched_s = now_s

    def go(self, angle_deg: float) -> bool:
        """Move there; false, and nothing happens, while the gateway has yet to confirm the angle before.

        So nothing piles up, however fast a key repeats: when it is released, one step is under way at most.
        """
        if self.wanted is None or self._confirmed_deg != self.wanted.angle_deg:
            return False
        self.wanted = replace(self.wanted, angle_deg=angle_deg)
        return True

    def stop(self, *, all_legs: bool = False) -> None:
        """Stop the leg, if it was started, or all six, and repeat nothing any more."""
        if all_legs:
            self._owed = ALL_LEGS
        self._end(None)

    def forget(self) -> None:
        """Somebody else drives, who stopped all legs: the leg is theirs, and a Stop of ours would be wrong."""
        self._owed = None
        self._end(None)

    def touched(self, now_s: float) -> None:
        """A key was pressed."""
        self._touched_s = now_s

    def seen(self, now_s: float) -> None:
        """The screen has turned: somebody can see what happens."""
        self._seen_s = now_s

    # ---- what is to be done

    def look(self, now_s: float) -> Wanted | None:
        """What to ask for now. None: nothing runs, or nobody is there any more."""
        if self.wanted is not None and now_s - self._seen_s > UNSEEN_S:
            self._end("this terminal was stuck, so the servo was stopped")
        elif self.wanted is not None and now_s - self._touched_s > UNTOUCHED_S:
            self._end(f"no key was pressed for {UNTOUCHED_S / 60:g} minutes, so the servo was stopped")
        self._starting = self.wanted is not None and self.wanted.op == "start"
        return self.wanted

    def takes_stop(self) -> bool:
        """Whether a Stop is to be requested now; each is taken once."""
        due, self._stop_due = self._stop_due, False
        return due

    @property
    def owed(self) -> int | None:
        """Which leg a Stop is to stop, or ALL_LEGS. None: none, for a newer start would get it."""
        return self._owed if self.wanted is None else None

    # ---- what comes of it

    def answered(self, asked: Wanted, ack: Ack, now_s: float) -> bool:
        """The gateway has answered; whether to ask at once, since what was rejected has not fed the watchdog."""
        started, self._starting = self._starting, False
        current = self.wanted
        if current is None or current.number != asked.number:
            self._overtaken(asked, runs=started and ack.accepted)
            return False
        self._answered_s = now_s
        if ack.accepted:
            self._confirmed_deg, self.has_run = asked.angle_deg, True
            self.wanted = replace(current, op="set")
            return False
        if ack.reason == Reason.JOINT_LIMIT and asked.op == "set" and self._confirmed_deg is not None:
            self.wanted = replace(current, angle_deg=self._confirmed_deg)
            self._rejected = (visible(ack.detail or "the gateway has a limit there"), self._confirmed_deg)
            return True
        if started or ack.reason in STOPPED:
            self._owed = None
        self._end(rejection(ack))
        return False

    def failed(self, asked: Wanted, fault: str, *, theirs: bool) -> None:
        """No answer came. `theirs`: somebody else holds the lease, and so has stopped all legs."""
        started, self._starting = self._starting, False
        if self.wanted is None or self.wanted.number != asked.number:
            self._overtaken(asked, runs=started)
            return
        if theirs:
            self._owed = None
        self._end(fault)

    def stop_ended(self, unconfirmed: str | None, *, more: bool) -> None:
        """What became of a Stop, None: it is confirmed; `more`: a later press is not."""
        if self.wanted is None and not more:  # and nothing has been started since
            self.unconfirmed = unconfirmed
            if unconfirmed is None:
                self._owed = None

    # ---- for the screen

    @property
    def running(self) -> bool:
        """Whether a servo is kept running, or is about to be started."""
        return self.wanted is not None

    @property
    def confirmed(self) -> bool:
        """Whether the gateway has confirmed that it runs."""
        return self._confirmed_deg is not None and self.wanted is not None

    @property
    def start_is_overtaken(self) -> bool:
        """A start is on its way that will get a Stop."""
        return self._starting and self.wanted is None

    @property
    def is_stopped(self) -> bool:
        """Whether no Stop is owed."""
        return self._owed is None and not self._starting

    def unanswered_s(self, now_s: float) -> float:
        """For how long the gateway has not answered."""
        return now_s - self._answered_s if self.wanted is not None else 0.0

    def rejected_step(self) -> tuple[str, float] | None:
        """Why the gateway rejected a step since the last call, and the angle where the servo stayed."""
        found, self._rejected = self._rejected, None
        return found

    # ---- inside

    def _overtaken(self, asked: Wanted, *, runs: bool) -> None:
        """Something else is wanted by now; where it `runs` all the same, its Stop may have come before it."""
        if not runs:
            return
        if self.wanted is None:
            self._owed = asked.servo_id // 10 if self._owed is None else self._owed
        else:  # two were started: nobody knows which of them a single leg's Stop would leave
            self._owed = ALL_LEGS
        self._end(None)

    def _end(self, fault: str | None) -> None:
        """Repeat nothing any more, and stop what was started."""
        self.wanted, self._confirmed_deg = None, None
        self.fault = fault or self.fault
        self._stop_due = self._owed is not None


def rejection(ack: Ack) -> str:
    """In words."""
    return visible(f"{ack.reason}: {ack.detail or 'no reason was given'}")
