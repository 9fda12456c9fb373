"""A robot's calibration: what of it is on the wire, when a change of it is in force, and what starts meanwhile.

Each step is judged by the oracle.
"""

from typing import Final

import pytest

from gateway.model.calibration import RobotCalibration, ServoMapping
from gateway.robot.core.calibrating import UNTIL_TRUSTED
from gateway.robot.core.events import CalibrationSaved
from gateway.robot.core.rules import Rules
from tests.support.scenes import Scenes, play, scene_test

MIRRORED = RobotCalibration(3, {32: ServoMapping(7_00, inverted=True, min_cdeg=10_00, max_cdeg=170_00)})
"""90 is 97 on its wire, and 10 is 177."""
AVOIDING = Rules(repeats=0, avoid_cdeg=(1_00, 4_00))
BROKEN = "/var/lib/x/calibration.toml: is not TOML"
TURN_32: Final = "calibrate 32 trim -5 inverted"


# ---- angles


def test_frames_carry_the_servos_own_angles_and_all_else_the_users() -> None:
    steps = Scenes(calibration=MIRRORED).play("""
        0.5 leg 3 start 90 → command 3 start 90 | start 97 | start 90; completed 1
        100 servo 32 set 45 → command 32 set 142; completed 2""")
    assert steps.supervisor.legs.servos[32].angle_cdeg == 45_00
    # A servo without a new target is sent its angle again, also by its own calibration.
    steps.play("200 servo 31 set 20 + servo 33 set 30 → command 3 set 20 | set 142 | set 30; completed 3")


def test_angles_that_are_never_sent_are_the_servos_own() -> None:
    steps = Scenes(AVOIDING, calibration=RobotCalibration(1, {32: ServoMapping(-3_00)}))
    steps.play("0.5 servo 32 start 5 → rejected 1 joint_limit")
    assert steps.detail == (
        "5 degrees of servo 32 are its own 2, with its calibration; angles on the wire from 1 up to 4 are never "
        "sent: where one byte is lost, the published firmware dies of whole degrees 1 to 3, with its servos on"
    )
    steps.play("1 servo 32 start 3 → command 32 start 0; completed 2")


def test_a_landing_pose_of_angles_that_are_never_sent_is_rejected_also_where_it_becomes_one_by_a_new_trim() -> None:
    Scenes(AVOIDING, calibration=RobotCalibration(1, {}, {32: 5_00})).play("""
        1 calibrate landing 31 3 → rejected 1 joint_limit
        2 calibrate 32 trim -3 → rejected 2 joint_limit
        mentions the landing pose cannot be sent: 5 degrees of servo 32 are its own 2, """)


# ---- a change


def test_a_change_is_in_force_once_it_is_kept() -> None:
    steps = play(f"0 {TURN_32} → keep 1")
    assert steps.supervisor.calibrating.in_force == RobotCalibration()
    steps.play("""
        50 kept → announce calibrated; completed 1
        announces calibration 1 is in force; it changes servo 32
        source anna
        key hexapod/calibration/cmd""")
    assert steps.supervisor.calibrating.in_force == RobotCalibration(1, {32: ServoMapping(-5_00, inverted=True)})
    steps.play("51 servo 32 start 90 → command 32 start 85; completed 2")


SCENES: Final = {
    "a servo that runs or waits to be started is not changed": """
        rules start_pause_ms=100
        0.5 servo 32 start 90
        1 servo 11 start 90  # waits
        2 calibrate 32 trim 0.01 → rejected 3 invalid
        says servo 32 runs or waits to be started; stop it before its calibration is changed
        3 calibrate 11 trim 0.01 → rejected 4 invalid
        says servo 11 runs or waits to be started; stop it before its calibration is changed
        4 calibrate 31 trim 0.01 + landing 32 90 → keep 5""",
    "nothing that is changed starts meanwhile": f"""
        0 {TURN_32}
        1 leg 3 start 90 → rejected 2 servo_stopped
        says servo 32 is being calibrated; start it once the change is saved
        2 servo 31 start 90 → command 31 start 90; …
        3 servo 32 stop → command 32 stop; …""",
    "one change at a time": f"""
        0 {TURN_32}
        1 calibrate nothing → rejected 2 stale
        2 kept
        3 calibrate nothing (revision 0) → rejected 3 stale
        says revision 0 is changed, and 1 is in force; look at it first
        4 calibrate nothing (revision 1) → keep 4""",
    "what is no calibration is rejected as a whole": """
        0 calibrate 32 trim 0.01 + 33 trim 90.01 → rejected 1 invalid
        says servo 33: trim_deg is 90.01; it is -90 to 90
        1 calibrate nothing (accept default) → rejected 2 invalid""",
    "only who may drive may change it": f"""
        0 lease acquire anna (fresh anna)
        1 {TURN_32} → rejected 1 not_holder
        500 {TURN_32} (revision 8, lease anna) → rejected 2 stale
        due 1000
        600 {TURN_32} (lease anna) → keep 3
        due 1600  # an accepted change renews the lease, and no other""",
}
test_a_scene = scene_test(SCENES)


@pytest.mark.parametrize("number", [0, 2])
def test_an_answer_that_nobody_waits_for_changes_nothing(number: int) -> None:
    steps = play(f"0 {TURN_32}")
    assert steps.supervisor.step(CalibrationSaved(number), 10**9) == []
    steps.play("1 kept → …; completed 1")
    assert steps.supervisor.step(CalibrationSaved(1), 10**12) == []


# ---- a calibration that cannot be trusted


def test_nothing_starts_by_a_calibration_that_cannot_be_read() -> None:
    why = f"{BROKEN}; nothing is started {UNTIL_TRUSTED}, by `calibrate`"
    Scenes(fault=BROKEN).play(f"""
        0.5 servo 11 start 90 → rejected 1 servo_stopped
        says {why}
        1 {TURN_32} → rejected 2 servo_stopped
        says {why}
        2 leg 1 stop → command 1 stop; completed 3
        3 estop → estop 1-6 stop; …""")


def test_the_default_is_accepted_once_it_is_kept_and_not_what_was_loaded() -> None:
    steps = Scenes(calibration=MIRRORED, fault=BROKEN).play("""
        0 calibrate 32 trim 1 (accept default) → keep 1
        1 servo 11 start 90 → rejected 2 servo_stopped
        2 kept the disk is full → rejected 1 invalid
        3 servo 11 start 90 → rejected 3 servo_stopped
        4 calibrate 32 trim 1 (accept default) → keep 4
        5 kept → announce calibrated; completed 4
        announces the default calibration is taken as this robot's; calibration 4 is in force; it changes servo 32
        6 servo 32 start 90 → command 32 start 91; completed 5""")
    assert steps.supervisor.calibrating.fault is None
    assert steps.supervisor.calibrating.in_force == RobotCalibration(4, {32: ServoMapping(1_00)})
