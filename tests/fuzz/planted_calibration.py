"""Calibrations with a bug each, for the model check to find."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from gateway.robot.core.calibrating import Calibrating
from gateway.robot.core.calibration import Calibration
from gateway.robot.core.events import Calibrate, Command, Effect, Kept, Rejected, Transmit
from gateway.robot.core.joint_limits import Reach
from gateway.robot.core.leg import Rules, Servo
from gateway.robot.core.legs import Legs
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.protocol.frames import Frame, OneServo, Op, ServoOp
from schemas.telemetry import Cause, Reason


def with_reach(reach: type[Reach], calibrating: type[Calibrating] = Calibrating) -> type[Supervisor]:
    """A supervisor with other reaches, or with another way to change them."""

    class Planted(Supervisor):
        def __init__(self, rules: Rules) -> None:
            super().__init__(rules)
            self._reach = reach(rules)
            self.calibrating = calibrating(self._reach)
            self.legs = Legs(rules, self._reach)

    return Planted


def with_calibrating(calibrating: type[Calibrating]) -> type[Supervisor]:
    """A supervisor whose calibration is changed in another way."""
    return with_reach(Reach, calibrating)


# ---- angles


class FramesAsCommanded(Reach):
    """Users' angles go on the wire."""

    def use(self, calibration: Calibration) -> None:
        super().use(calibration)
        self.wire = None


class _ServosOnly(Calibration):
    def frame(self, frame: Frame) -> Frame:
        return super().frame(frame) if isinstance(frame, OneServo) else frame


class WholeLegsAsCommanded(Reach):
    """A servo that is told its angle again, beside another one's, is told the users'."""

    def use(self, calibration: Calibration) -> None:
        super().use(calibration)
        self.wire = _ServosOnly(calibration.revision, calibration.servos, calibration.landing_cdeg)


class OldWire(Reach):
    """The first calibration stays on the wire, whatever is in force."""

    def use(self, calibration: Calibration) -> None:
        wire = getattr(self, "wire", None)
        super().use(calibration)
        self.wire = wire or self.wire


class AnyAngle(Reach):
    """The calibration's limits are not looked at."""

    def use(self, calibration: Calibration) -> None:
        super().use(calibration)
        self.limited = False


class LandsWhereTheSettingsSay(Reach):
    """The pose that a person recorded is not approached."""

    def landing_cdeg(self) -> dict[int, int]:
        return dict(self._landing_cdeg)


# ---- changes


class InForceAtOnce(Calibrating):
    """Nobody waits for the disk."""

    def change(self, event: Calibrate, servos: Mapping[int, Servo]) -> list[Effect]:
        effects = super().change(event, servos)
        if self._on_its_way is not None:
            self._reach.use(self._on_its_way.calibration)
        return effects


class InForceThoughNotKept(Calibrating):
    """What the disk did not take is in force until the next start."""

    def kept(self, event: Kept) -> list[Effect]:
        way = self._on_its_way
        effects = super().kept(event)
        if way is not None:
            self._reach.use(way.calibration)
        return effects


class ChangesWhatRuns(Calibrating):
    """A running servo gets another trim, and jumps at its next frame."""

    def change(self, event: Calibrate, servos: Mapping[int, Servo]) -> list[Effect]:
        return super().change(event, {servo_id: Servo(servo_id, servo.leg) for servo_id, servo in servos.items()})


class ChangesWhatWaits(Calibrating):
    """A start that waits for its rate slot is sent by another calibration than it was checked by."""

    def change(self, event: Calibrate, servos: Mapping[int, Servo]) -> list[Effect]:
        return super().change(event, {name: replace(servo, waiting=None) for name, servo in servos.items()})


class StartsMeanwhile(Calibrating):
    """What is being changed starts by the old calibration, and goes on by the new."""

    def rejection(self, moves: Iterable[tuple[int, ServoOp]]) -> tuple[Reason, str] | None:
        return None if self.fault is None else super().rejection(moves)


class TheLatestChangeCounts(Calibrating):
    """A second change takes the place of the one that is on its way."""

    def change(self, event: Calibrate, servos: Mapping[int, Servo]) -> list[Effect]:
        self._on_its_way = None
        return super().change(event, servos)


class AnyRevision(Calibrating):
    """Of two people who calibrate, one undoes the other's work unseen."""

    def change(self, event: Calibrate, servos: Mapping[int, Servo]) -> list[Effect]:
        return super().change(replace(event, revision=None), servos)


class StartsUntrusted(Calibrating):
    """A robot whose calibration cannot be read starts by whatever is left of it."""

    def load(self, calibration: Calibration, fault: str | None = None) -> None:
        super().load(calibration, fault)
        self.guards = False


class TrustsAnyAnswer(Calibrating):
    """The default counts as accepted though the disk did not take it."""

    def kept(self, event: Kept) -> list[Effect]:
        effects = super().kept(event)
        self.fault, self.guards = None, False
        return effects


class AnybodyCalibrates(Supervisor):
    """A change needs no lease."""

    def _calibrate(self, event: Calibrate, now_ns: int) -> list[Effect]:
        effects = super()._calibrate(event, now_ns)
        no_lease = [effect for effect in effects if isinstance(effect, Rejected) and effect.reason is Reason.NOT_HOLDER]
        return self.calibrating.change(event, self.legs.servos) if no_lease else effects


class CalibratesInAnyMode(Supervisor):
    """A change is taken while the emergency stop is engaged, or the bus is at fault."""

    def _calibrate(self, event: Calibrate, now_ns: int) -> list[Effect]:
        del now_ns
        return self.calibrating.change(event, self.legs.servos)


class StandsUpToShow(Calibrating):
    """A servo is started by its new calibration, for people to see."""

    def kept(self, event: Kept) -> list[Effect]:
        return [Transmit(OneServo(11, ServoOp(Op.START, 90_00)), Cause.COMMAND), *super().kept(event)]


class StopsWaitForTheDisk(Supervisor):
    """While a calibration is on its way, a Stop on command has to come again."""

    def _command(self, command: Command, now_ns: int) -> list[Effect]:
        if self.calibrating.guards and all(op.op is Op.STOP for _, op in command.targets):
            return [Rejected(command.number, Reason.SERVO_STOPPED, "busy")]
        return super()._command(command, now_ns)
