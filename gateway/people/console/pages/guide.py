"""The state of a calibration guide: the calibration in force, the draft, and the angle of the servo under test. Pure.

The servo is always commanded by the calibration in force, since the gateway knows no other. What the person sees
concerns the servo itself, so it is kept as its angle on the wire; only the draft changes until it is written.
"""

import math
from dataclasses import dataclass, field

from gateway.model.calibration import AS_DRAWN, CalibrationError, RobotCalibration, ServoMapping, changed_servos
from gateway.model.frames import MAX_ANGLE_CDEG, centidegrees
from schemas.robot import SERVO_IDS


@dataclass
class Guide:
    """Angles are in degrees (`_deg`) or hundredths of a degree (`_cdeg`). Each change of the draft can be undone."""

    in_force: RobotCalibration
    avoid_cdeg: tuple[int, int] | None = None
    """Angles on the wire that the gateway never sends: from the first up to, not including, the second."""
    draft: dict[int, ServoMapping] = field(init=False)
    servo_id: int | None = None
    wire_cdeg: int = 0
    """The commanded angle of the servo under test, on the wire."""
    _before: list[tuple[int, ServoMapping]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.draft = {servo_id: self.in_force.of(servo_id) for servo_id in SERVO_IDS}

    # ---- the servo under test

    def choose(self, servo_id: int, shown_deg: float) -> None:
        """Test this servo, from this angle by the draft.

        Raises CalibrationError for a servo that does not exist, or an angle that the calibration in force rejects.
        """
        if servo_id not in SERVO_IDS:
            raise CalibrationError(f"servo {servo_id} does not exist; an id is the leg and the joint, such as 32")
        wire_cdeg = self.draft[servo_id].wire_cdeg(_cdeg(shown_deg))
        self._check(servo_id, self.in_force.of(servo_id).user_cdeg(wire_cdeg))
        self.servo_id, self.wire_cdeg = servo_id, wire_cdeg

    def leave(self) -> None:
        """Put no servo under test."""
        self.servo_id = None

    def jog(self, by_cdeg: int) -> None:
        """Move by this angle by the draft, or past the angles that are never sent.

        Raises CalibrationError at the limits of the calibration in force.
        """
        servo_id, servo = self._under_test()
        wire_cdeg = self.wire_cdeg + (-by_cdeg if servo.inverted else by_cdeg)
        if self.avoid_cdeg is not None and self.avoid_cdeg[0] <= wire_cdeg < self.avoid_cdeg[1]:
            wire_cdeg = self.avoid_cdeg[0] - 1 if wire_cdeg < self.wire_cdeg else self.avoid_cdeg[1]
        if not 0 <= wire_cdeg <= MAX_ANGLE_CDEG:
            raise CalibrationError(f"servo {servo_id} cannot go further: its own angle would be {wire_cdeg / 100:g}")
        self._check(servo_id, self.in_force.of(servo_id).user_cdeg(wire_cdeg))
        self.wire_cdeg = wire_cdeg

    @property
    def command_deg(self) -> float:
        """The angle to command, by the calibration in force."""
        servo_id, _ = self._under_test()
        return self.in_force.of(servo_id).user_cdeg(self.wire_cdeg) / 100

    @property
    def shown_deg(self) -> float:
        """The servo's angle by the draft."""
        _, servo = self._under_test()
        return servo.user_cdeg(self.wire_cdeg) / 100

    # ---- what the person sees

    def stands_at(self, seen_deg: float) -> None:
        """Set the trim, by its angle now as measured on the robot."""
        servo_id, servo = self._under_test()
        trim_cdeg = self.wire_cdeg - servo._replace(trim_cdeg=0).wire_cdeg(_cdeg(seen_deg))
        self._change(servo_id, servo._replace(trim_cdeg=trim_cdeg))

    def wrong_way(self) -> None:
        """Reverse its direction. The servo's middle and its two limits stay where they are on the robot."""
        servo_id, servo = self._under_test()
        low_cdeg, high_cdeg = MAX_ANGLE_CDEG - servo.max_cdeg, MAX_ANGLE_CDEG - servo.min_cdeg
        inverted = servo._replace(inverted=not servo.inverted, min_cdeg=low_cdeg, max_cdeg=high_cdeg)
        self._change(servo_id, inverted)

    def lowest_here(self) -> None:
        """Make its angle now the lowest."""
        servo_id, servo = self._under_test()
        self._change(servo_id, servo._replace(min_cdeg=servo.user_cdeg(self.wire_cdeg)))

    def highest_here(self) -> None:
        """Make its angle now the highest."""
        servo_id, servo = self._under_test()
        self._change(servo_id, servo._replace(max_cdeg=servo.user_cdeg(self.wire_cdeg)))

    def full_range(self) -> None:
        """Remove its limits: 0 to 180 degrees."""
        servo_id, servo = self._under_test()
        self._change(servo_id, servo._replace(min_cdeg=0, max_cdeg=MAX_ANGLE_CDEG))

    def as_drawn(self) -> None:
        """Remove its trim, direction and limits."""
        servo_id, _ = self._under_test()
        self._change(servo_id, AS_DRAWN)

    def undo(self) -> int | None:
        """Undo the draft's latest change; returns its servo, None if there is none."""
        if not self._before:
            return None
        servo_id, servo = self._before.pop()
        self.draft[servo_id] = servo
        return servo_id

    # ---- to write

    @property
    def changed(self) -> list[int]:
        """The servos whose calibration the draft changes."""
        return sorted(changed_servos(self.in_force, RobotCalibration(servos=self.draft)))

    @property
    def landing_left_out(self) -> list[int]:
        """The servos whose angle in the landing pose is outside the draft's limits: they leave the pose."""
        drafted = RobotCalibration(servos=self.draft)
        return [
            servo_id
            for servo_id, angle_cdeg in sorted(self.in_force.landing_cdeg.items())
            if drafted.why_not(servo_id, angle_cdeg) is not None
        ]

    def now_in_force(self, calibration: RobotCalibration) -> list[int]:
        """Another calibration is in force, by this draft or by another person's change.

        The draft keeps its changed servos, and takes all others from the new calibration. Returns the servos that both
        changed, and differently.
        """
        mine = self.changed
        theirs = changed_servos(self.in_force, calibration)
        self.in_force = calibration
        self.draft = {name: self.draft[name] if name in mine else calibration.of(name) for name in SERVO_IDS}
        return [servo_id for servo_id in self.changed if servo_id in theirs]

    # ---- inside

    def _under_test(self) -> tuple[int, ServoMapping]:
        if self.servo_id is None:
            raise CalibrationError("choose a servo first")
        return self.servo_id, self.draft[self.servo_id]

    def _check(self, servo_id: int, user_cdeg: int) -> None:
        """Raise CalibrationError if the gateway would reject this angle by the calibration in force."""
        if not 0 <= user_cdeg <= MAX_ANGLE_CDEG:
            raise CalibrationError(
                f"the calibration in force has no command for it ({user_cdeg / 100:g} degrees); write the draft first"
            )
        why_not = self.in_force.why_not(servo_id, user_cdeg)
        if why_not is not None:
            raise CalibrationError(why_not)

    def _change(self, servo_id: int, servo: ServoMapping) -> None:
        RobotCalibration(servos={servo_id: servo})  # raises CalibrationError
        if servo != self.draft[servo_id]:
            self._before.append((servo_id, self.draft[servo_id]))
            self.draft[servo_id] = servo


def _cdeg(angle_deg: float) -> int:
    """Return the nearest hundredth of a degree. Raises CalibrationError beyond 360 degrees."""
    if not math.isfinite(angle_deg) or abs(angle_deg) > 360:
        raise CalibrationError(f"{angle_deg:g} is no angle of a servo: that is 0 to 180 degrees")
    return centidegrees(angle_deg)
