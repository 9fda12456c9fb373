"""What the guide knows: the calibration in force, the draft, and where the servo under test stands. Pure.

The servo is always commanded in the angles of the calibration in force, since the gateway speaks no other. What the
person says is about the servo itself, and so about its angle on the wire; only the draft changes until the end.
"""

import math
from dataclasses import dataclass, field

from gateway.model.calibration import AS_DRAWN, Calibration, CalibrationError, ServoCalibration, changed_servos
from gateway.model.frames import MAX_ANGLE_CDEG, centidegrees
from schemas.robot import SERVO_IDS


@dataclass
class Guide:
    """One walk through some servos. Each method that changes the draft can be undone."""

    in_force: Calibration
    avoid_cdeg: tuple[int, int] | None = None
    """A servo's own angles that the gateway never sends, from the first up to, not including, the second."""
    draft: dict[int, ServoCalibration] = field(init=False)
    servo_id: int | None = None
    wire_cdeg: int = 0
    """Where the servo under test was commanded to stand: its own angle."""
    _before: list[tuple[int, ServoCalibration]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.draft = {servo_id: self.in_force.of(servo_id) for servo_id in SERVO_IDS}

    # ---- the servo under test

    def choose(self, servo_id: int, shown_deg: float) -> None:
        """Test this servo, from this angle as the draft counts.

        Raises CalibrationError for a servo that does not exist, or an angle that the calibration in force rejects.
        """
        if servo_id not in SERVO_IDS:
            raise CalibrationError(f"servo {servo_id} does not exist; an id is the leg and the joint, such as 32")
        wire_cdeg = self.draft[servo_id].wire_cdeg(_cdeg(shown_deg))
        self._check(servo_id, self.in_force.of(servo_id).user_cdeg(wire_cdeg))
        self.servo_id, self.wire_cdeg = servo_id, wire_cdeg

    def leave(self) -> None:
        """No servo is under test any more."""
        self.servo_id = None

    def jog(self, by_cdeg: int) -> None:
        """Move on by so much, as the draft counts, or to behind angles that are never sent.

        Raises CalibrationError where the calibration in force ends.
        """
        servo_id, servo = self._under_test()
        wire_cdeg = self.wire_cdeg + (-by_cdeg if servo.inverted else by_cdeg)
        if self.avoid_cdeg is not None and self.avoid_cdeg[0] <= wire_cdeg < self.avoid_cdeg[1]:
            wire_cdeg = self.avoid_cdeg[0] - 1 if wire_cdeg < self.wire_cdeg else self.avoid_cdeg[1]
        if not 0 <= wire_cdeg <= MAX_ANGLE_CDEG:
            raise CalibrationError(
                f"servo {servo_id} has no more way to go: its own angle would be {wire_cdeg / 100:g}"
            )
        self._check(servo_id, self.in_force.of(servo_id).user_cdeg(wire_cdeg))
        self.wire_cdeg = wire_cdeg

    @property
    def command_deg(self) -> float:
        """What to send, as the calibration in force counts."""
        servo_id, _ = self._under_test()
        return self.in_force.of(servo_id).user_cdeg(self.wire_cdeg) / 100

    @property
    def shown_deg(self) -> float:
        """Where the servo stands, as the draft counts."""
        _, servo = self._under_test()
        return servo.user_cdeg(self.wire_cdeg) / 100

    # ---- what the person says

    def stands_at(self, seen_deg: float) -> None:
        """It now stands at this angle, measured on the robot: sets the trim."""
        servo_id, servo = self._under_test()
        trim_cdeg = self.wire_cdeg - servo._replace(trim_cdeg=0).wire_cdeg(_cdeg(seen_deg))
        self._change(servo_id, servo._replace(trim_cdeg=trim_cdeg))

    def wrong_way(self) -> None:
        """It turns the other way: sets the direction. The servo's middle and its two ends stay where they are."""
        servo_id, servo = self._under_test()
        low_cdeg, high_cdeg = MAX_ANGLE_CDEG - servo.max_cdeg, MAX_ANGLE_CDEG - servo.min_cdeg
        turned = servo._replace(inverted=not servo.inverted, min_cdeg=low_cdeg, max_cdeg=high_cdeg)
        self._change(servo_id, turned)

    def lowest_here(self) -> None:
        """It must not go below where it stands."""
        servo_id, servo = self._under_test()
        self._change(servo_id, servo._replace(min_cdeg=servo.user_cdeg(self.wire_cdeg)))

    def highest_here(self) -> None:
        """It must not go above where it stands."""
        servo_id, servo = self._under_test()
        self._change(servo_id, servo._replace(max_cdeg=servo.user_cdeg(self.wire_cdeg)))

    def full_range(self) -> None:
        """No limits of its own any more."""
        servo_id, servo = self._under_test()
        self._change(servo_id, servo._replace(min_cdeg=0, max_cdeg=MAX_ANGLE_CDEG))

    def as_drawn(self) -> None:
        """No trim, not inverted, the full range."""
        servo_id, _ = self._under_test()
        self._change(servo_id, AS_DRAWN)

    def undo(self) -> int | None:
        """Take the last change of the draft back; the servo whose it was, None if there was none."""
        if not self._before:
            return None
        servo_id, servo = self._before.pop()
        self.draft[servo_id] = servo
        return servo_id

    # ---- the end

    @property
    def changed(self) -> list[int]:
        """The servos whose calibration the draft changes."""
        return sorted(changed_servos(self.in_force, Calibration(servos=self.draft)))

    @property
    def landing_left_out(self) -> list[int]:
        """The servos whose angle in the landing pose the draft does not reach: they cannot stay in it."""
        drafted = Calibration(servos=self.draft)
        return [
            servo_id
            for servo_id, angle_cdeg in sorted(self.in_force.landing_cdeg.items())
            if drafted.why_not(servo_id, angle_cdeg) is not None
        ]

    def now_in_force(self, calibration: Calibration) -> list[int]:
        """Another calibration is in force, by this draft or by somebody else's change.

        The draft stands on it: a servo that it changed is as the person left it, any other one as it is now in force.
        Returns the servos that both have changed, to different ends.
        """
        mine = self.changed
        theirs = changed_servos(self.in_force, calibration)
        self.in_force = calibration
        self.draft = {name: self.draft[name] if name in mine else calibration.of(name) for name in SERVO_IDS}
        return [servo_id for servo_id in self.changed if servo_id in theirs]

    # ---- inside

    def _under_test(self) -> tuple[int, ServoCalibration]:
        if self.servo_id is None:
            raise CalibrationError("choose a servo first")
        return self.servo_id, self.draft[self.servo_id]

    def _check(self, servo_id: int, user_cdeg: int) -> None:
        """Raise CalibrationError where the gateway would reject this angle by the calibration in force."""
        if not 0 <= user_cdeg <= MAX_ANGLE_CDEG:
            raise CalibrationError(
                f"the calibration in force has no command for it ({user_cdeg / 100:g} degrees); write the draft first"
            )
        why_not = self.in_force.why_not(servo_id, user_cdeg)
        if why_not is not None:
            raise CalibrationError(why_not)

    def _change(self, servo_id: int, servo: ServoCalibration) -> None:
        Calibration(servos={servo_id: servo})  # raises CalibrationError
        if servo != self.draft[servo_id]:
            self._before.append((servo_id, self.draft[servo_id]))
            self.draft[servo_id] = servo


def _cdeg(angle_deg: float) -> int:
    """To the nearest hundredth. Raises CalibrationError for what is no angle of a servo at all."""
    if not math.isfinite(angle_deg) or abs(angle_deg) > 360:
        raise CalibrationError(f"{angle_deg:g} is no angle of a servo: that is 0 to 180 degrees")
    return centidegrees(angle_deg)
