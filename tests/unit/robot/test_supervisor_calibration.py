"""The calibration in the supervisor: users' angles inside, the servos' own on the wire, changed while nothing runs.

Each step is judged by the oracle.
"""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.calibration import CalibrationChange, MappingChange, RobotCalibration, ServoMapping
from gateway.robot.core.events import Announce, CalibrationSaved
from gateway.robot.core.leg import Rules
from gateway.robot.core.legal import IllegalEvent
from schemas.telemetry import Kind, Mode
from tests.support.steps import Steps, all_stopped, leg_to, servo_to

MIRRORED = RobotCalibration(3, {32: ServoMapping(7_00, inverted=True, min_cdeg=10_00, max_cdeg=170_00)})
"""90 is 97 on its wire, and 10 is 177."""
TURN_32 = CalibrationChange({32: MappingChange(trim_cdeg=-5_00, inverted=True)}, {})
NOTHING = CalibrationChange({}, {})


# ---- angles


def test_frames_carry_the_servos_own_angles_and_all_else_the_users() -> None:
    steps = Steps(calibration=MIRRORED)
    assert steps.command(0.5, leg_to(3, "start 90")) == ["command 3 start 90 | start 97 | start 90", "completed 1"]
    assert steps.command(100, servo_to(32, "set 45")) == ["command 32 set 142", "completed 2"]
    assert steps.supervisor.legs.servos[32].angle_cdeg == 45_00
    # A servo that nothing waits for is told its angle again, its own as well.
    assert steps.command(200, (*servo_to(31, "set 20"), *servo_to(33, "set 30"))) == [
        "command 3 set 20 | set 142 | set 30",
        "completed 3",
    ]
    assert steps.command(201, leg_to(3, "stop")) == ["command 3 stop", "completed 4"]


@pytest.mark.parametrize("angle", ["9.99", "170.01"])
def test_what_the_calibration_excludes_is_rejected_with_the_whole_command(angle: str) -> None:
    steps = Steps(calibration=MIRRORED)
    assert steps.command(0.5, leg_to(3, "start 90", f"start {angle}", "start 90")) == ["rejected 1 joint_limit"]
    assert steps.detail == f"servo 32 is calibrated to go from 10 to 170 degrees; {angle} is outside"


def test_the_settings_limits_hold_as_well_and_count_as_users_do() -> None:
    steps = Steps(Rules(repeats=0, joint_limits_cdeg={32: (80_00, 100_00)}), calibration=MIRRORED)
    assert steps.command(0.5, servo_to(32, "start 79")) == ["rejected 1 joint_limit"]
    assert steps.detail == "servo 32 may go from 80 to 100 degrees; 79 is outside"
    assert steps.command(1, servo_to(32, "start 80")) == ["command 32 start 107", "completed 2"]


def test_it_is_the_servos_own_angle_that_is_never_sent() -> None:
    calibration = RobotCalibration(1, {32: ServoMapping(-3_00)})
    steps = Steps(Rules(repeats=0, avoid_cdeg=(1_00, 4_00)), calibration=calibration)
    assert steps.command(0.5, servo_to(32, "start 5")) == ["rejected 1 joint_limit"]
    assert steps.detail == (
        "5 degrees of servo 32 are its own 2, with its calibration; angles on the wire from 1 up to 4 are never "
        "sent: where one byte is lost, the published firmware dies of whole degrees 1 to 3, with its servos on"
    )
    assert steps.command(1, servo_to(32, "start 3")) == ["command 32 start 0", "completed 2"]


def test_a_landing_pose_of_angles_that_are_never_sent_is_rejected() -> None:
    """Also where it becomes one by a new trim."""
    steps = Steps(Rules(repeats=0, avoid_cdeg=(1_00, 4_00)), calibration=RobotCalibration(1, {}, {32: 5_00}))
    assert steps.calibrate(1, CalibrationChange({}, {31: 3_00})) == ["rejected 1 joint_limit"]
    assert steps.calibrate(2, CalibrationChange({32: MappingChange(trim_cdeg=-3_00)}, {})) == ["rejected 2 joint_limit"]
    assert steps.detail.startswith("the landing pose cannot be sent: 5 degrees of servo 32 are its own 2, ")


# ---- a change


def test_a_change_is_in_force_once_it_is_kept() -> None:
    steps = Steps()
    assert steps.calibrate(0, TURN_32) == ["keep 1"]
    assert steps.supervisor.calibrating.in_force == RobotCalibration()
    assert steps.kept(50) == ["announce calibrated", "completed 1"]
    told = "calibration 1 is in force; it changes servo 32"
    assert steps.announced == [Announce(Kind.CALIBRATED, told, "anna", "hexapod/calibration/cmd")]
    assert steps.supervisor.calibrating.in_force == RobotCalibration(1, {32: ServoMapping(-5_00, inverted=True)})
    assert steps.command(51, servo_to(32, "start 90")) == ["command 32 start 85", "completed 2"]


def test_a_change_that_the_disk_does_not_take_changes_nothing() -> None:
    steps = Steps(calibration=MIRRORED)
    steps.calibrate(0, TURN_32)
    assert steps.kept(50, "the disk is full; the old calibration stays") == ["rejected 1 invalid"]
    assert steps.detail == "the disk is full; the old calibration stays"
    assert steps.supervisor.calibrating.in_force == MIRRORED
    assert steps.command(51, servo_to(32, "start 90")) == ["command 32 start 97", "completed 2"]


def test_a_servo_that_runs_or_waits_to_be_started_is_not_changed() -> None:
    steps = Steps(Rules(repeats=0, start_pause_ns=100 * NS_PER_MS))
    steps.command(0.5, servo_to(32, "start 90"))
    steps.command(1, servo_to(11, "start 90"))  # waits
    for at_ms, servo_id in ((2, 32), (3, 11)):
        assert steps.calibrate(at_ms, CalibrationChange({servo_id: MappingChange(trim_cdeg=1)}, {}))[0].endswith(
            "invalid"
        )
        expected = f"servo {servo_id} runs or waits to be started; stop it before its calibration is changed"
        assert steps.detail == expected
    assert steps.calibrate(4, CalibrationChange({31: MappingChange(trim_cdeg=1)}, {32: 90_00})) == ["keep 5"]


def test_nothing_that_is_changed_starts_meanwhile() -> None:
    steps = Steps()
    steps.calibrate(0, TURN_32)
    assert steps.command(1, leg_to(3, "start 90")) == ["rejected 2 servo_stopped"]
    assert steps.detail == "servo 32 is being calibrated; start it once the change is saved"
    assert steps.command(2, servo_to(31, "start 90"))[0] == "command 31 start 90"
    assert steps.command(3, servo_to(32, "stop"))[0] == "command 32 stop"


def test_one_change_at_a_time() -> None:
    steps = Steps()
    steps.calibrate(0, TURN_32)
    assert steps.calibrate(1, NOTHING) == ["rejected 2 stale"]
    steps.kept(2)
    assert steps.calibrate(3, NOTHING, revision=0) == ["rejected 3 stale"]
    assert steps.detail == "revision 0 is changed, and 1 is in force; look at it first"
    assert steps.calibrate(4, NOTHING, revision=1) == ["keep 4"]


def test_what_is_no_calibration_is_rejected_as_a_whole() -> None:
    steps = Steps()
    change = CalibrationChange({32: MappingChange(trim_cdeg=1), 33: MappingChange(trim_cdeg=90_01)}, {})
    assert steps.calibrate(0, change) == ["rejected 1 invalid"]
    assert steps.detail == "servo 33: trim_deg is 90.01; it is -90 to 90"
    assert steps.calibrate(1, NOTHING, accept_default=True) == ["rejected 2 invalid"]


def test_only_who_may_drive_may_change_it() -> None:
    steps = Steps()
    steps.lease(0, "acquire anna", fresh="a" * 32)
    assert steps.calibrate(1, TURN_32) == ["rejected 1 not_holder"]
    assert steps.calibrate(500, TURN_32, revision=8, lease="a" * 32) == ["rejected 2 stale"]
    assert steps.due_ms == 1000
    assert steps.calibrate(600, TURN_32, lease="a" * 32) == ["keep 3"]
    assert steps.due_ms == 1600, "an accepted change renews the lease, and no other"


def test_nothing_is_changed_where_nothing_may_move() -> None:
    steps = Steps(Rules(repeats=0, landing_ns=500 * NS_PER_MS))
    steps.command(0.5, servo_to(11, "start 90"))
    steps.time(250.5)
    assert steps.calibrate(251, TURN_32) == ["rejected 2 landing"]
    steps.outside(252, at_work=True)
    assert steps.calibrate(253, TURN_32) == ["rejected 3 servo_stopped"]
    steps.outside(254, at_work=False)
    steps.estop(255)
    assert steps.calibrate(256, TURN_32) == ["rejected 4 estopped"]
    steps.fail(257)
    assert steps.calibrate(258, TURN_32) == ["rejected 5 bus_fault"]
    steps.end(259)
    assert steps.calibrate(260, TURN_32) == ["rejected 6 stopping"]


@pytest.mark.parametrize("number", [0, 2])
def test_an_answer_that_nobody_waits_for_changes_nothing(number: int) -> None:
    steps = Steps()
    steps.calibrate(0, TURN_32)
    with pytest.raises(IllegalEvent, match="is not on its way"):
        steps.supervisor.step(CalibrationSaved(number), 10**12)
    assert steps.kept(1)[-1] == "completed 1"
    with pytest.raises(IllegalEvent, match="is not on its way"):
        steps.supervisor.step(CalibrationSaved(1), 10**12)


# ---- a calibration that cannot be trusted

BROKEN = "/var/lib/x/calibration.toml: is not TOML"


def test_nothing_starts_by_a_calibration_that_cannot_be_read() -> None:
    steps = Steps(fault=BROKEN)
    assert steps.command(0.5, servo_to(11, "start 90")) == ["rejected 1 servo_stopped"]
    why = (
        "/var/lib/x/calibration.toml: is not TOML; nothing is started until `calibrate "
        "accept-default` takes the default calibration as this robot's"
    )
    assert steps.detail == why
    assert steps.calibrate(1, TURN_32) == ["rejected 2 servo_stopped"]
    assert steps.detail == why
    assert steps.command(2, leg_to(1, "stop")) == ["command 1 stop", "completed 3"]
    assert steps.estop(3)[:6] == all_stopped("estop")


def test_the_default_is_accepted_once_it_is_kept() -> None:
    steps = Steps(calibration=RobotCalibration(6), fault=BROKEN)
    assert steps.calibrate(0, NOTHING, accept_default=True) == ["keep 1"]
    assert steps.command(1, servo_to(11, "start 90")) == ["rejected 2 servo_stopped"]
    assert steps.kept(2, "the disk is full") == ["rejected 1 invalid"]
    assert steps.command(3, servo_to(11, "start 90")) == ["rejected 3 servo_stopped"]
    assert steps.calibrate(4, NOTHING, accept_default=True) == ["keep 4"]
    assert steps.kept(5) == ["announce calibrated", "completed 4"]
    expected = "the default calibration is taken as this robot's; calibration 7 is in force; it changes nothing"
    assert steps.announced[0].detail == expected
    assert steps.supervisor.calibrating.fault is None
    assert steps.command(6, servo_to(11, "start 90")) == ["command 11 start 90", "completed 5"]
    assert steps.supervisor.mode is Mode.ACTIVE


def test_the_default_is_what_is_accepted_and_not_what_was_loaded() -> None:
    steps = Steps(calibration=MIRRORED, fault=BROKEN)
    steps.calibrate(0, CalibrationChange({11: MappingChange(trim_cdeg=1_00)}, {}), accept_default=True)
    steps.kept(1)
    assert steps.supervisor.calibrating.in_force == RobotCalibration(4, {11: ServoMapping(1_00)})
