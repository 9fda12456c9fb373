"""The part of the oracle (`oracle.py`) that is about the calibration.

The formula, the limits and what a change changes are written once more here, so that a mistake in the core meets
another reading of them.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Self

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import Frame, OneLeg, OneServo, Op, ServoOp
from gateway.robot.core.events import Calibrate, CalibrationSaved, Effect, SaveCalibration, Transmit
from gateway.robot.core.rules import Rules
from schemas.calibration import ServoChange
from schemas.words import Kind, Reason
from tests.support.history import demand, is_announced, spelled_out


class OneServos(NamedTuple):
    """One servo's calibration: its wire angles, and the angles that may be asked for."""

    trim_cdeg: int = 0
    inverted: bool = False
    low_cdeg: int = 0
    high_cdeg: int = 180_00

    def wire_cdeg(self, angle_cdeg: int) -> int:
        """Return the angle that the contract sends to the servo."""
        return self.trim_cdeg + (180_00 - angle_cdeg if self.inverted else angle_cdeg)

    def user_cdeg(self, wire_cdeg: int) -> int:
        """Return the only angle for which the contract sends this one."""
        return 180_00 + self.trim_cdeg - wire_cdeg if self.inverted else wire_cdeg - self.trim_cdeg

    def allows(self, angle_cdeg: int) -> bool:
        """Return whether this angle may be asked for."""
        return self.low_cdeg <= angle_cdeg <= self.high_cdeg and 0 <= self.wire_cdeg(angle_cdeg) <= 180_00

    def with_change(self, change: ServoChange) -> Self:
        """Return the calibration after a change, possible or not."""
        return type(self)(
            self.trim_cdeg if change.trim_deg is None else round(change.trim_deg * 100),
            self.inverted if change.inverted is None else change.inverted,
            self.low_cdeg if change.min_deg is None else round(change.min_deg * 100),
            self.high_cdeg if change.max_deg is None else round(change.max_deg * 100),
        )

    @property
    def possible(self) -> bool:
        """Return whether a servo can have this calibration."""
        return abs(self.trim_cdeg) <= 90_00 and 0 <= self.low_cdeg <= self.high_cdeg <= 180_00


AS_DRAWN = OneServos()


class Whole(NamedTuple):
    """A robot's calibration. Only servos that are not as drawn are named."""

    revision: int
    servos: Mapping[int, OneServos]
    landing_cdeg: Mapping[int, int]

    @classmethod
    def of(cls, calibration: RobotCalibration) -> Self:
        """Return the oracle's form of a calibration of `gateway/robot/core`."""
        servos = {servo_id: OneServos(*servo) for servo_id, servo in calibration.servos.items()}
        return cls(calibration.revision, _not_as_drawn(servos), dict(calibration.landing_cdeg))

    def allows(self, servo_id: int, angle_cdeg: int) -> bool:
        """Return whether this angle may be asked of this servo."""
        return self.servos.get(servo_id, AS_DRAWN).allows(angle_cdeg)

    def changed(self, event: Calibrate) -> Self | None:
        """Return the calibration after a change, or None if that is impossible."""
        servos, landing = dict(self.servos), dict(self.landing_cdeg)
        for name, change in event.change.servos.items():
            servos[int(name)] = servos.get(int(name), AS_DRAWN).with_change(change)
        for name, angle_deg in event.change.landing.items():
            landing.pop(int(name), None)
            if angle_deg is not None:
                landing[int(name)] = round(angle_deg * 100)
        after = type(self)(self.revision + 1, _not_as_drawn(servos), landing)
        possible = all(servo.possible for servo in servos.values())
        return after if possible and all(after.allows(*pair) for pair in landing.items()) else None


def _not_as_drawn(servos: Mapping[int, OneServos]) -> dict[int, OneServos]:
    return {servo_id: servo for servo_id, servo in sorted(servos.items()) if servo != AS_DRAWN}


class _OnItsWay(NamedTuple):
    number: int
    whole: Whole
    servos: frozenset[int]


class CalibrationHistory:
    """The calibration in force, whether it is trusted, and the change that is on its way to the disk."""

    def __init__(self, rules: Rules, calibration: RobotCalibration, fault: str | None) -> None:
        self._rules = rules
        self.whole = Whole.of(calibration)
        self.trusted = fault is None
        self.on_its_way: _OnItsWay | None = None

    def key(self) -> tuple[object, ...]:
        """Return what still matters."""
        way = self.on_its_way
        return self.trusted, _key(self.whole), way and (_key(way.whole), way.servos)

    # ---- angles

    def allows(self, servo_id: int, angle_cdeg: int) -> bool:
        """Return whether the settings and the calibration both allow this angle."""
        low, high = self._rules.joint_limits_cdeg.get(servo_id, (0, 180_00))
        within = low <= angle_cdeg <= high and self.whole.allows(servo_id, angle_cdeg)
        return within and not self._avoids(self.whole, servo_id, angle_cdeg)

    def wire_cdeg(self, servo_id: int, angle_cdeg: int) -> int:
        """Return the wire angle of this angle."""
        return self.whole.servos.get(servo_id, AS_DRAWN).wire_cdeg(angle_cdeg)

    def _avoids(self, whole: Whole, servo_id: int, angle_cdeg: int) -> bool:
        """Return whether this angle is never on the wire."""
        low, high = self._rules.avoid_cdeg or (0, 0)
        return low <= whole.servos.get(servo_id, AS_DRAWN).wire_cdeg(angle_cdeg) < high

    def gap(self, servo_id: int, from_cdeg: int, to_cdeg: int) -> tuple[int, int] | None:
        """Return the last angle before and the first after those that are never on the wire; None: none lie between."""
        servo = self.whole.servos.get(servo_id, AS_DRAWN)
        low, high = self._rules.avoid_cdeg or (0, 0)
        below, above = servo.user_cdeg(low - 1), servo.user_cdeg(high)
        from_below, to_below = servo.wire_cdeg(from_cdeg) < low, servo.wire_cdeg(to_cdeg) < low
        if not high or from_below == to_below:
            return None
        return (below, above) if from_below else (above, below)

    def landing_cdeg(self) -> dict[int, int]:
        """Return the landing pose, without angles that are not allowed."""
        pose = {**self._rules.landing_cdeg, **self.whole.landing_cdeg}
        return {servo_id: angle for servo_id, angle in pose.items() if self.allows(servo_id, angle)}

    def read(self, effects: Iterable[Effect]) -> list[Effect]:
        """Return the effects, spelled out, with users' angles in frames. Raise Violation for a forbidden angle."""
        return [
            replace(effect, frame=self._read(effect.frame)) if isinstance(effect, Transmit) else effect
            for effect in spelled_out(effects)
        ]

    def _read(self, frame: Frame) -> Frame:
        ops = [self._meant(servo_id, op) for servo_id, op in frame.servos]
        return (
            OneServo(frame.servos[0][0], ops[0])
            if isinstance(frame, OneServo)
            else OneLeg(frame.leg, (ops[0], ops[1], ops[2]))
        )

    def _meant(self, servo_id: int, op: ServoOp) -> ServoOp:
        if op.op is Op.STOP:
            return op
        angle_cdeg = self.whole.servos.get(servo_id, AS_DRAWN).user_cdeg(op.angle_cdeg)
        demand(self.allows(servo_id, angle_cdeg), f"{servo_id} is sent where it must not go: {angle_cdeg}")
        return ServoOp(op.op, angle_cdeg)

    # ---- changes

    def reason_to_reject(self, servo_ids: Collection[int]) -> Reason | None:
        """Return why none of these servos may be started or set, or None."""
        changing = self.on_its_way is not None and not self.on_its_way.servos.isdisjoint(servo_ids)
        return Reason.SERVO_STOPPED if changing or not self.trusted else None

    def calibrate(
        self, event: Calibrate, effects: Iterable[Effect], closed: Reason | None, alive: Collection[int]
    ) -> Reason | None:
        """Return why the change must be rejected, or None: then it must be kept, and is on its way from here on.

        `closed` is why no start would be taken at all; `alive` are the servos that run or wait to be started.
        """
        keeps = [effect for effect in effects if isinstance(effect, SaveCalibration)]
        before = self.whole if self.trusted else Whole(self.whole.revision, {}, {})
        after = before.changed(event)
        reason = closed or self._reason(event)
        if reason is None and after is None:
            reason = Reason.INVALID
        if reason is None and after is not None and any(self._avoids(after, *p) for p in after.landing_cdeg.items()):
            reason = Reason.JOINT_LIMIT
        changed = frozenset[int]()
        if reason is None and after is not None:
            servos = {*self.whole.servos, *after.servos}
            changed = frozenset(s for s in servos if self.whole.servos.get(s) != after.servos.get(s))
            reason = None if changed.isdisjoint(alive) else Reason.INVALID
        if reason is not None or after is None:
            demand(not keeps, f"what is rejected is not kept: {keeps}")
            return reason
        self.on_its_way = _OnItsWay(event.number, after, changed)
        same = [(keep.number, Whole.of(keep.calibration)) for keep in keeps] == [(event.number, after)]
        demand(same, f"the change is kept as it was asked for, before it is in force: {after}, not {keeps}")
        return None

    def _reason(self, event: Calibrate) -> Reason | None:
        if self.on_its_way is not None or event.change.revision not in (None, self.whole.revision):
            return Reason.STALE
        if not self.trusted and not event.change.accept_default:
            return Reason.SERVO_STOPPED
        return Reason.INVALID if self.trusted and event.change.accept_default else None

    def kept(self, event: CalibrationSaved, effects: Sequence[Effect], alive: Collection[int]) -> Reason | None:
        """Take the disk's answer. Return why the change is rejected; None: it is in force from here on."""
        way, self.on_its_way = self.on_its_way, None
        demand(way is not None and way.number == event.number, "what is kept was on its way")
        if way is not None and event.fault is None:
            moving = sorted(way.servos.intersection(alive))
            demand(not moving, f"a calibration never changes for a servo that runs or is about to: {moving}")
            self.whole, self.trusted = way.whole, True
        demand(is_announced(effects, Kind.CALIBRATED) == (event.fault is None), "a new calibration is announced")
        return None if event.fault is None else Reason.INVALID


def _key(whole: Whole) -> tuple[object, ...]:
    return tuple(whole.servos.items()), tuple(sorted(whole.landing_cdeg.items()))
