"""The guide: what a person sees on the robot becomes trim, direction and limits."""

import pytest

from gateway.model.calibration import CalibrationError, RobotCalibration, ServoMapping
from gateway.people.console.pages.page_calibration import Guide

COARSE_CDEG = 100
FINE_CDEG = 10


def guide(servo: ServoMapping | None = None, start_deg: float = 90.0) -> Guide:
    made = Guide(RobotCalibration(servos={} if servo is None else {32: servo}))
    made.choose(32, start_deg)
    return made


@pytest.mark.parametrize(("trim_cdeg", "inverted"), [(0, False), (-2_00, False), (-2_00, True)])
def test_keys_move_over_angles_that_are_never_sent(trim_cdeg: int, inverted: bool) -> None:
    """It is the servo's own angle that is never sent; both ways, and by each key."""
    made = Guide(RobotCalibration(servos={32: ServoMapping(trim_cdeg, inverted)}), (1_00, 4_00))
    made.choose(32, 90)
    down = -1 if not inverted else 1
    made.wire_cdeg = 5_50
    for by_cdeg, wire_cdeg in (
        (COARSE_CDEG, 4_50),
        (COARSE_CDEG, 99),
        (FINE_CDEG, 89),
        (-FINE_CDEG, 99),
        (-FINE_CDEG, 4_00),
    ):
        made.jog(down * by_cdeg)
        assert made.wire_cdeg == wire_cdeg


def test_a_servo_that_turns_the_other_way() -> None:
    made = guide(start_deg=80.0)
    made.change("highest_here")
    made.change("wrong_way")
    assert made.shown_deg == 100.0
    made.jog(COARSE_CDEG)
    assert made.shown_deg == 101.0
    assert made.command_deg == 79.0
    made.change("stands_at", 100.0)
    assert made.draft[32] == ServoMapping(-1_00, inverted=True, min_cdeg=100_00, max_cdeg=180_00)


def test_a_highest_and_a_lowest_angle_are_set_and_the_lowest_is_not_above() -> None:
    made = guide()
    made.jog(FINE_CDEG)
    made.change("highest_here")
    made.jog(-40 * COARSE_CDEG)
    made.change("lowest_here")
    assert made.draft[32] == ServoMapping(min_cdeg=50_10, max_cdeg=90_10)
    made.jog(41 * COARSE_CDEG)
    with pytest.raises(CalibrationError, match="min_deg must not be larger"):
        made.change("lowest_here")
    assert made.draft[32] == ServoMapping(min_cdeg=50_10, max_cdeg=90_10)


def test_undo_goes_back_to_the_beginning_and_as_drawn_to_no_calibration() -> None:
    made = guide()
    made.change("stands_at", 95.0)
    made.change("wrong_way")
    assert made.changed == [32]
    assert made.undo() == 32
    assert made.draft[32] == ServoMapping(trim_cdeg=-5_00)
    assert made.undo() == 32
    assert made.undo() is None
    assert made.changed == []
    made = guide(ServoMapping(7_00, inverted=True))
    made.change("as_drawn")
    assert (made.draft[32], made.changed) == (ServoMapping(), [32])


def test_the_guide_never_leaves_what_the_gateway_accepts() -> None:
    made = guide(ServoMapping(max_cdeg=92_00))
    made.jog(2 * COARSE_CDEG)
    with pytest.raises(CalibrationError, match="calibrated to go from 0 to 92 degrees"):
        made.jog(FINE_CDEG)
    assert made.command_deg == 92.0
    with pytest.raises(CalibrationError, match="has no command for it"):
        guide(ServoMapping(20_00), 0.0).jog(-COARSE_CDEG)
    with pytest.raises(CalibrationError, match="cannot go further"):
        guide(start_deg=180.0).jog(FINE_CDEG)


def test_a_servo_that_is_none() -> None:
    with pytest.raises(CalibrationError, match="servo 34 does not exist"):
        guide().choose(34, 90)
    made = guide()
    made.servo_id = None
    with pytest.raises(CalibrationError, match="choose a servo first"):
        made.change("stands_at", 90)
