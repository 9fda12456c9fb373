"""examples/elkapod: its files agree with each other, with the gait, and with the robot's own numbers."""

from pathlib import Path
from typing import Final

import pytest

from examples.elkapod import gait
from gateway.core.calibration import Calibration
from gateway.core.pacing import NS_PER_MS
from gateway.core.speed import step
from gateway.geometry import foot_m, load
from gateway.host import calibration_file
from gateway.protocol.frames import centidegrees
from gateway.settings import Settings
from gateway.settings import load as load_settings
from schemas.robot import LEGS, SERVO_IDS

FOLDER: Final = Path(gait.__file__).parent
SETTINGS: Final[Settings] = load_settings(FOLDER / "gateway.toml", simulated=True)
PERIOD_MS: Final = 20
FRAMES: Final = round(2 * gait.STEP_S * 1000 / PERIOD_MS)
MG996R_DEG_S: Final = 353


def cdeg_at(ms: float) -> dict[int, int]:
    """Where the gait wants each servo, in hundredths of a degree."""
    return {
        10 * leg + joint: centidegrees(angle)
        for leg, angles in gait.pose(ms / 1000).items()
        for joint, angle in enumerate(angles, start=1)
    }


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    read = calibration_file.read(FOLDER / "calibration.toml")
    assert read is not None
    return read


def test_joints_2_and_3_of_the_right_legs_are_mirrored_and_nothing_else(calibration: Calibration) -> None:
    for servo_id in SERVO_IDS:
        leg, joint = divmod(servo_id, 10)
        assert calibration.of(servo_id).inverted == (leg in (2, 4, 6) and joint in (2, 3))
        assert calibration.of(servo_id).trim_cdeg == 0


def test_with_the_calibration_each_servo_stands_where_the_robots_own_software_puts_it(calibration: Calibration) -> None:
    servos, users = load(), load(FOLDER / "geometry.json")
    assert servos.model_copy(update={"servos": users.servos}) == users
    for servo_id in SERVO_IDS:
        low, high = users.joints[servo_id % 10 - 1].limits_rad
        for joint_rad in (low, (low + high) / 2, 0.9 * high):
            user_cdeg = centidegrees(users.servos[servo_id].servo_deg(joint_rad))
            own_deg = servos.servos[servo_id].servo_deg(joint_rad)
            assert calibration.of(servo_id).wire_cdeg(user_cdeg) / 100 == pytest.approx(own_deg, abs=0.011)


def test_the_feet_that_stand_are_on_the_ground_and_push_the_body_forward() -> None:
    geometry = load(FOLDER / "geometry.json")
    straight_m = geometry.foot.model_copy(update={"origin_xyz_m": (gait.TIBIA_M, 0.0, 0.0)})
    geometry = geometry.model_copy(update={"chain": (*geometry.joints, straight_m)})

    def feet(seconds: float) -> dict[int, tuple[float, float, float]]:
        angles = {
            10 * leg + j: deg for leg, three in gait.pose(seconds).items() for j, deg in enumerate(three, start=1)
        }
        joints_rad = {servo_id: geometry.joint_rad(servo_id, deg) for servo_id, deg in angles.items()}
        return {leg: foot_m(geometry, leg, joints_rad) for leg in LEGS}

    early, late = feet(0.1), feet(0.5)
    for leg in LEGS:
        stands = leg in (2, 3, 6)
        if stands:
            assert early[leg][2] == pytest.approx(late[leg][2], abs=1e-3)
        moved_m = late[leg][0] - early[leg][0]
        assert moved_m == pytest.approx(gait.STRIDE_M * 0.4 / (gait.STEP_S / 2) * (-1 if stands else 1), abs=1e-3)
        assert late[leg][1] == pytest.approx(early[leg][1], abs=1e-3)


def test_the_gait_and_the_landing_pose_are_within_the_limits(calibration: Calibration) -> None:
    limits = SETTINGS.limits.servos
    assert set(limits) == set(SETTINGS.watchdog.landing) == set(map(str, SERVO_IDS))
    for ms in range(0, round(gait.STEP_S * 1000), 5):
        for servo_id, cdeg in cdeg_at(ms).items():
            assert limits[str(servo_id)].min_deg <= cdeg / 100 <= limits[str(servo_id)].max_deg
            assert calibration.why_not(servo_id, cdeg) is None
    for name, deg in SETTINGS.watchdog.landing.items():
        assert calibration.why_not(int(name), centidegrees(deg)) is None


def test_the_speed_limit_is_below_the_servos_and_never_holds_the_gait_back() -> None:
    """At a steady 50 Hz each frame carries what was commanded; after a late one the lag is made up within the next."""
    speeds_cdeg_s = {int(name): round(100 * servo.max_speed_deg_s) for name, servo in SETTINGS.limits.servos.items()}
    assert 0 < max(speeds_cdeg_s.values()) / 100 < MG996R_DEG_S
    period_ns = PERIOD_MS * NS_PER_MS
    for late_ms in (0, 10):
        at, since_ns = cdeg_at(0), 0
        for frame in range(1, FRAMES):
            due_ms = frame * PERIOD_MS
            wanted = cdeg_at(due_ms)
            now_ns = (due_ms + (late_ms if frame % 10 == 0 else 0)) * NS_PER_MS
            reached = {
                servo_id: step(at[servo_id], wanted[servo_id], speed, since_ns, now_ns, period_ns).angle_cdeg
                for servo_id, speed in speeds_cdeg_s.items()
            }
            if not late_ms or frame % 10 != 1:
                assert reached == wanted, f"at {due_ms} ms"
            at, since_ns = reached, now_ns
