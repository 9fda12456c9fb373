"""`stop-servos` at work on the same device: all legs count as stopped, and get a Stop from the gateway, too. Pure.

Until its end is known, no Start or Set is accepted, since a later Stop of `stop-servos` would undo it unnoticed.
"""

from typing import Final

from gateway.robot.core.events import Announce, Calibrate, Command, Effect, StoppedOutside
from gateway.robot.core.interlock import Interlock
from gateway.robot.core.legs import Halt
from schemas.words import Cause, Kind, Reason

_OUTSIDE: Final = "stop-servos stops all servos past the gateway; start them once it has ended"


class Outside(Interlock[StoppedOutside]):
    """Whether `stop-servos` is at work: then this is `closed`."""

    takes = (StoppedOutside,)
    bars = (Command, Calibrate)
    objection = (Reason.SERVO_STOPPED, _OUTSIDE)

    def halts(self, event: StoppedOutside) -> Halt | None:
        return Halt(Cause.REPEAT, Reason.SERVO_STOPPED, _OUTSIDE) if event.at_work else None

    def take(self, event: StoppedOutside, now_ns: int) -> list[Effect]:  # noqa: ARG002
        before, self.closed = self.closed, event.at_work
        detail = "stop-servos stopped all servos past the gateway; nothing moves until it is started again"
        return [Announce(Kind.STOPPED_OUTSIDE, detail)] if self.closed and not before else []
