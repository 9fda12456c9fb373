"""Stops for a leg, the event of a changed source, and rejections of dropped commands. Pure."""

from gateway.model.frames import SETS, STOP, OneServo, ServoOp, stop_leg
from gateway.robot.core.events import Announce, Command, Effect, Rejected, Transmit
from gateway.robot.core.leg import Leg, Servo
from schemas.telemetry import Cause, Kind, Reason


def as_it_is(servo: Servo) -> ServoOp:
    """Return the operation that repeats the servo's current state."""
    return STOP if servo.angle_cdeg is None else SETS[servo.angle_cdeg]


def stops(leg: Leg, servos: list[Servo], cause: Cause, commands: tuple[Command, ...] = ()) -> list[Effect]:
    """Return Stops for these servos of a leg: one frame for all three, else one for each."""
    if len(servos) == len(leg.servos):
        return [Transmit(stop_leg(leg.number), cause, None, commands)]
    return [Transmit(OneServo(servo.servo_id, STOP), cause, None, commands) for servo in servos]


def taken_over(leg: Leg, source: str | None, moves: bool) -> list[Effect]:
    """Set the leg's source, and return the event if the leg had another. A stopped leg has no previous source.

    A Stop without a name (a delete has none) may be from the leg's previous source.
    """
    before, leg.source = leg.source, source
    if not leg.armed or (source is None and not moves):
        return []
    new, old = ("somebody without a name" if name is None else name for name in (source, before))
    detail = f"leg {leg.number} is commanded by {new}, and was by {old}"
    return [Announce(Kind.SOURCE_CHANGED, detail, source, legs=(leg.number,))]


def withdrawn(command: Command, reason: Reason, detail: str) -> Rejected:
    """Return the rejection of a command that is dropped. Its Stops were written, unless the bus failed."""
    if reason is not Reason.BUS_FAULT:
        command.stopped = tuple(servo_id for servo_id, _ in command.stops)
    return Rejected(command, reason, detail)
