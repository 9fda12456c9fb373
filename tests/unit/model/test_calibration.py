"""Trim, direction and limits: what is accepted has a legal wire angle, and the way back gives the user's angle."""

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.model.angle_limits import AngleLimits
from gateway.model.calibration import (
    CalibrationError,
    RobotCalibration,
    ServoMapping,
    calibration_of,
    changed,
    report_of,
)
from gateway.model.frames import MAX_ANGLE_CDEG, STOP, Frame, decode
from schemas.calibration import CalibrationCommand, ServoCalibration
from schemas.robot import SERVO_IDS
from tests.unit.model.test_frames import frames

angles = st.integers(0, MAX_ANGLE_CDEG)
trims = st.integers(-90_00, 90_00)


@st.composite
def servo_calibrations(draw: st.DrawFn) -> ServoMapping:
    low, high = sorted((draw(angles), draw(angles)))
    return ServoMapping(draw(trims), draw(st.booleans()), low, high)


calibrations = st.builds(
    RobotCalibration, st.just(1), st.dictionaries(st.sampled_from(SERVO_IDS), servo_calibrations())
)


@given(calibrations, frames)
def test_what_is_accepted_has_a_legal_wire_angle_and_reads_back_as_the_user_said_it(
    calibration: RobotCalibration, frame: Frame
) -> None:
    if any(op is not STOP and calibration.why_not(servo_id, op.angle_cdeg) for servo_id, op in frame.servos):
        return
    wire = calibration.frame(frame)  # a frame that is not legal cannot be made: FrameError
    assert calibration.user_frame(decode(wire.data)) == frame
    assert [op.op for _, op in wire.servos] == [op.op for _, op in frame.servos]


def test_a_calibration_is_published_in_degrees_and_one_that_no_gateway_publishes_is_an_error() -> None:
    report = report_of(RobotCalibration(1, {31: ServoMapping(-12_34, True, 1_00, 170_00)}, {32: 45_50}))
    assert (report.revision, len(report.servos), report.landing) == (1, 18, {"32": 45.5})
    assert report.servos["31"] == ServoCalibration(trim_deg=-12.34, inverted=True, min_deg=1, max_deg=170)
    assert calibration_of(report).landing_cdeg == {32: 45_50}
    without = CalibrationCommand(servos={}, landing={"31": 20.0, "32": None})
    assert changed(calibration_of(report), without).landing_cdeg == {31: 20_00}
    for wrong in ({"70": 90.0}, {"32": float("inf")}, {"032": 90.0}):
        with pytest.raises(ValueError, match="Input should be"):
            calibration_of(report.model_copy(update={"landing": wrong}))


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize(
    ("from_deg", "to_deg", "crosses", "sent_deg"),
    [
        (6, 4, False, 4),
        (6, 3.99, False, 4),
        (6, 1, False, 4),
        (6, 0.99, True, 0.99),
        (0, 0.99, False, 0.99),
        (0, 1, True, 0.99),
        (0, 3.99, True, 0.99),
        (0, 4, True, 4),
    ],
)
def test_a_way_across_angles_that_are_never_sent(
    from_deg: float, to_deg: float, crosses: bool, sent_deg: float, inverted: bool
) -> None:
    """From 1 up to 4 degrees on the wire. An end among them is where the way is now, and not where it leads."""
    reach = AngleLimits(avoid_cdeg=(1_00, 4_00))
    if inverted:
        reach.use(RobotCalibration(1, {32: ServoMapping(inverted=True)}))
    from_cdeg, to_cdeg, sent_cdeg = (
        round(18000 - deg * 100 if inverted else deg * 100) for deg in (from_deg, to_deg, sent_deg)
    )
    assert reach.crosses(32, from_cdeg, to_cdeg) is crosses
    assert reach.near_side(32, from_cdeg, to_cdeg) == sent_cdeg
    assert (reach.why_not(32, to_cdeg) is None) == (sent_deg == to_deg)
    free = AngleLimits({32: (1_00, 4_00)})
    assert not free.crosses(32, from_cdeg, to_cdeg)
    assert free.near_side(32, from_cdeg, to_cdeg) == to_cdeg
    if not inverted:
        assert (free.why_not(32, to_cdeg) is None) == (1 <= to_deg <= 4)


@given(calibrations, st.sampled_from(SERVO_IDS), angles, st.sampled_from([None, (1_00, 4_00)]), angles, angles)
def test_only_what_breaks_a_rule_is_rejected(
    calibration: RobotCalibration, servo_id: int, at_cdeg: int, avoid: tuple[int, int] | None, low: int, high: int
) -> None:
    reach = AngleLimits({servo_id: (low, high)}, avoid_cdeg=avoid)
    reach.use(calibration)
    servo, avoided = calibration.of(servo_id), reach.why_avoided(calibration, servo_id, at_cdeg)
    wire_cdeg = servo.trim_cdeg + (18000 - at_cdeg if servo.inverted else at_cdeg)
    allowed = servo.min_cdeg <= at_cdeg <= servo.max_cdeg and 0 <= wire_cdeg <= 18000
    assert (calibration.why_not(servo_id, at_cdeg) is None) == allowed
    assert (reach.why_not(servo_id, at_cdeg) is None) == (low <= at_cdeg <= high and allowed and avoided is None)


def test_a_rejection_names_both_angles() -> None:
    calibration = RobotCalibration(servos={32: ServoMapping(20_00), 33: ServoMapping(max_cdeg=140_00)})
    assert calibration.why_not(32, 170_00) == (
        "170 degrees of servo 32 are its own 190, with its trim; a servo has 0 to 180"
    )
    assert calibration.why_not(33, 140_01) == ("servo 33 is calibrated to go from 0 to 140 degrees; 140.01 is outside")
    assert calibration.why_not(33, 140_00) is None
    for trim_cdeg, last_cdeg, beyond_cdeg in ((20_00, 160_00, 160_01), (-20_00, 20_00, 19_99)):
        calibration = RobotCalibration(servos={32: ServoMapping(trim_cdeg)})
        assert calibration.why_not(32, last_cdeg) is None
        assert calibration.why_not(32, beyond_cdeg) is not None


LIMITS = "they are 0 to 180, min_deg must not be larger"


@pytest.mark.parametrize(
    ("servos", "landing", "fault"),
    [
        ({32: ServoMapping(90_01)}, {}, "servo 32: trim_deg is 90.01; it is -90 to 90"),
        ({32: ServoMapping(-400_00)}, {}, "servo 32: trim_deg is -400; it is -90 to 90"),
        ({32: ServoMapping(min_cdeg=-1)}, {}, f"servo 32: min_deg is -0.01 and max_deg 180; {LIMITS}"),
        ({32: ServoMapping(max_cdeg=180_01)}, {}, f"servo 32: min_deg is 0 and max_deg 180.01; {LIMITS}"),
        ({32: ServoMapping(min_cdeg=91_00, max_cdeg=90_00)}, {}, f"servo 32: min_deg is 91 and max_deg 90; {LIMITS}"),
        (
            {32: ServoMapping(max_cdeg=100_00)},
            {32: 101_00},
            "the landing pose cannot be reached: servo 32 is calibrated to go from 0 to 100 degrees; 101 is outside",
        ),
    ],
)
def test_what_is_no_calibration(servos: Mapping[int, ServoMapping], landing: Mapping[int, int], fault: str) -> None:
    with pytest.raises(CalibrationError) as raised:
        RobotCalibration(1, servos, landing)
    assert str(raised.value) == fault
