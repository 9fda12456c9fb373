"""What the guide knows: the calibration in force, the draft, and where the servo under test stands. Pure.

The servo is always commanded in the angles of the calibration in force, since the gateway speaks no other. What the
person says is about the servo itself, and so about its angle on the wire; only the draft changes until the end.
"""

from dataclasses import dataclass, field
from typing import Final

from gateway.core.calibration import AS_DRAWN, Calibration, CalibrationError, ServoCalibration, changed_servos
from gateway.protocol.frames import MAX_ANGLE_CDEG, centidegrees
from schemas.robot import SERVO_IDS

COARSE_CDEG: Final = 100
FINE_CDEG: Final = 10
MIDDLE_CDEG: Final = 90_00


@dataclass
class Guide:
    """One walk through some servos. Each method that changes the draft can be undone."""

    in_force: Calibration
    draft: dict[int, ServoCalibration] = field(init=False)
    servo_id: int | None = None
    wire_cdeg: int = 0
    """Where the servo under test was told to stand: its own angle."""
    _before: list[dict[int, ServoCalibration]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.draft = {servo_id: self.in_force.of(servo_id) for servo_id in SERVO_IDS}

    # ---- the servo under test

    def choose(self, servo_id: int) -> None:
        """Test this servo, from its middle or as near to it as the calibration in force lets it go.

        Raises CalibrationError for a servo that does not exist.
        """
        if servo_id not in SERVO_IDS:
            raise CalibrationError(f"servo {servo_id} does not exist; an id is the leg and the joint, such as 32")
        servo = self.in_force.of(servo_id)
        ends = sorted((servo.user_cdeg(0), servo.user_cdeg(MAX_ANGLE_CDEG)))
        low_cdeg, high_cdeg = max(ends[0], servo.min_cdeg), min(ends[1], servo.max_cdeg)
        user_cdeg = min(max(MIDDLE_CDEG, low_cdeg), high_cdeg)
        self._check(servo_id, user_cdeg)
        self.servo_id, self.wire_cdeg = servo_id, servo.wire_cdeg(user_cdeg)

    def leave(self) -> None:
        """No servo is under test any more."""
        self.servo_id = None

    def jog(self, by_cdeg: int) -> None:
        """Move on by so much, as the draft counts. Raises CalibrationError where the calibration in force ends."""
        servo_id, servo = self._under_test()
        wire_cdeg = self.wire_cdeg + (-by_cdeg if servo.inverted else by_cdeg)
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
        trim_cdeg = self.wire_cdeg - servo._replace(trim_cdeg=0).wire_cdeg(centidegrees(seen_deg))
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

    def as_drawn(self) -> None:
        """No trim, not inverted, the full range."""
        servo_id, _ = self._under_test()
        self._change(servo_id, AS_DRAWN)

    def undo(self) -> bool:
        """Take the last change of the draft back; whether there was one."""
        if not self._before:
            return False
        self.draft = self._before.pop()
        return True

    # ---- the end

    @property
    def changed(self) -> list[int]:
        """The servos whose calibration the draft changes."""
        return sorted(changed_servos(self.in_force, Calibration(servos=self.draft)))

    # ---- inside

    def _under_test(self) -> tuple[int, ServoCalibration]:
        if self.servo_id is None:
            raise CalibrationError("choose a servo first")
        return self.servo_id, self.draft[self.servo_id]

    def _check(self, servo_id: int, user_cdeg: int) -> None:
        if not 0 <= user_cdeg <= MAX_ANGLE_CDEG:
            raise CalibrationError(
                f"the calibration in force has no command for it ({user_cdeg / 100:g} degrees); write the draft first"
            )
        why_not = self.in_force.why_not(servo_id, user_cdeg)
        if why_not is not None:
            raise CalibrationError(why_not)

    def _change(self, servo_id: int, servo: ServoCalibration) -> None:
        Calibration(servos={servo_id: servo})  # raises CalibrationError
        self._before.append(dict(self.draft))
        self.draft[servo_id] = servo
