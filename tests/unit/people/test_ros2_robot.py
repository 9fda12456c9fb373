"""What the robot publishes of itself in ROS 2, as bytes, too; and joint names and positions that controllers send."""

import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as Xml

import pytest
from ruamel.yaml import YAML

from gateway.geometry import load
from gateway.geometry.kinematics import Quaternion, Vector, plus, rotated, times
from gateway.geometry.model import TOTAL_KG
from gateway.model.calibration import RobotCalibration, ServoMapping, report_of
from gateway.model.frames import Frame, OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.people.incidents.messages import RecordedMessage
from gateway.people.incidents.story import frames_in
from gateway.people.recorder.drawing import encode
from gateway.people.ros2.commanded import UserAngles
from gateway.people.ros2.joints import JointNames, JointsError, check_reach, legs_deg, positions_of
from gateway.people.ros2.messages import Imu, JointState, String, Time
from gateway.people.ros2.received import SILENT_S, Rivals, read_each
from gateway.people.ros2.robot import MEASURED, description, frames, joint_state, measured, odometry, odometry_frame
from gateway.people.walking.inverse import Limb
from gateway.people.walking.motion import Odometry, Velocity
from schemas.keys import CALIBRATION, FRAME, STATE
from schemas.robot import JOINTS, MAX_DEG, SERVO_IDS
from schemas.telemetry import Telemetry
from tests.support import published
from tests.support.ros2_messages import STORE, Duration

GEOMETRY: Final = load()
NOW_NS: Final = 1_700_000_000_123_456_789


def test_joint_states_are_in_the_order_of_the_urdf_and_leave_out_what_is_not_known() -> None:
    found = joint_state({63: 0.5, 11: 0.25}, NOW_NS)
    assert (found.name, found.position) == (("joint_11", "joint_63"), (0.25, 0.5))
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == divmod(NOW_NS, 10**9)
    text = description(GEOMETRY).data
    places = [text.index(f'<joint name="joint_{servo_id}"') for servo_id in SERVO_IDS]
    assert places == sorted(places)
    assert joint_state({}, NOW_NS) == JointState(found.header, (), ())


def test_all_links_but_the_root_have_a_mass_and_together_the_robots() -> None:
    """KDL ignores a root's mass, and pybullet gives 1 kg to each link without one."""
    root, *links = Xml.fromstring(description(GEOMETRY).data).findall("link")  # noqa: S314 -- our own
    assert (root.get("name"), root.find("inertial")) == ("base", None)
    masses = [float(link.find("inertial/mass").get("value")) for link in links]  # type: ignore[union-attr,arg-type]
    moments = [[float(at.get(axis, 0)) for axis in ("ixx", "iyy", "izz")] for at in map(inertia, links)]
    assert math.isclose(sum(masses), TOTAL_KG, rel_tol=1e-9)
    assert len(masses) == 1 + 6 * 4
    assert all(x > 0 and y > 0 and z > 0 for x, y, z in moments)


def inertia(link: Xml.Element) -> Xml.Element:
    found = link.find("inertial/inertia")
    assert found is not None
    return found


def test_odometry_is_less_sure_the_longer_the_way_and_knows_nothing_of_height_and_lean() -> None:
    at, velocity = Odometry(1.0, -2.0, math.pi / 2), Velocity(0.1, 0.02, 0.3)
    near, far = (odometry(at, velocity, way_m, NOW_NS, "body") for way_m in (0.0, 3.0))
    assert (near.header.frame_id, near.child_frame_id) == ("odom", "body")
    turned = near.pose.pose.orientation
    assert (turned.z, turned.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert (near.twist.twist.linear.x, near.twist.twist.linear.y, near.twist.twist.angular.z) == (0.1, 0.02, 0.3)
    for place in (0, 7, 35):
        assert 0 < near.pose.covariance[place] < far.pose.covariance[place] < 1
    assert math.sqrt(far.pose.covariance[0]) == pytest.approx(0.31)
    assert {far.pose.covariance[place] for place in (14, 21, 28)} == {1e6}
    (frame,) = odometry_frame(at, NOW_NS, "body").transforms
    assert (frame.header.frame_id, frame.child_frame_id) == ("odom", "body")
    assert (frame.transform.translation.x, frame.transform.rotation.z) == pytest.approx((1.0, turned.z))


def test_a_walk_goes_on_where_the_one_before_it_ended() -> None:
    there = Odometry(1.0, 0.0, math.pi / 2).then(Odometry(2.0, 1.0, 0.1))
    assert there == pytest.approx((0.0, 2.0, math.pi / 2 + 0.1))


def test_frames_lead_to_the_feet() -> None:
    joints_rad = {servo_id: (servo_id - 36) / 100 for servo_id in SERVO_IDS}
    steps = {step.child_frame_id: step for step in frames(GEOMETRY, joints_rad, NOW_NS).transforms}
    for leg in range(1, 7):
        at_m: Vector = (0.0, 0.0, 0.0)
        turned: Quaternion = (0.0, 0.0, 0.0, 1.0)
        for link in ("coxa", "femur", "tibia", "foot"):
            move = steps[f"leg_{leg}_{link}"].transform
            to, by = move.translation, move.rotation
            at_m = plus(at_m, rotated(turned, (to.x, to.y, to.z)))
            turned = times(turned, (by.x, by.y, by.z, by.w))
        first, second, third = (joints_rad[10 * leg + joint] for joint in JOINTS)
        assert at_m == pytest.approx(Limb(GEOMETRY, leg).forward((first, second, third)).foot_m)


def as_rosbags_reads(found: Telemetry) -> dict[str, Any]:
    return {
        topic: STORE.deserialize_cdr(encode(message), message.TYPE)
        for topic, message in measured(found, NOW_NS)
        if isinstance(message, MEASURED[topic])
    }


def test_what_it_measures_is_in_ros_2s_units_and_what_nobody_knows_is_nan() -> None:
    found = as_rosbags_reads(published.MEASURED)
    assert found.keys() == MEASURED.keys()
    battery, imu, temperature = found["battery_state"], found["imu/data"], found["temperature"]
    assert (battery.voltage, battery.percentage, battery.present) == (pytest.approx(7.4), pytest.approx(0.8), True)
    unknown = (battery.temperature, battery.current, battery.charge, battery.capacity, battery.design_capacity)
    assert all(map(math.isnan, unknown))
    assert (battery.power_supply_status, battery.power_supply_health, battery.power_supply_technology) == (0, 0, 0)
    assert (imu.orientation.w, imu.orientation.x) == (1.0, 0.0)
    assert (imu.angular_velocity.z, imu.linear_acceleration.z) == (0.5, 9.81)
    covariances = (imu.orientation_covariance, imu.angular_velocity_covariance, imu.linear_acceleration_covariance)
    assert [each.tolist() for each in covariances] == [[0.0] * 9] * 3
    assert (temperature.temperature, temperature.variance) == (31.5, 0.0)
    assert found["foot_forces"].data.tolist() == list(published.MEASURED.feet or ())
    (legs,) = found["foot_forces"].layout.dim
    assert (legs.label, legs.size, legs.stride) == ("leg", 6, 6)
    for each in (battery, imu, temperature):
        at_ns = each.header.stamp.sec * 10**9 + each.header.stamp.nanosec
        assert (at_ns, each.header.frame_id) == (NOW_NS - 12_500_000, "base"), "when it was measured"


@pytest.mark.parametrize(
    ("left_out", "topic"),
    [("battery", "battery_state"), ("imu", "imu/data"), ("temperature_c", "temperature"), ("feet", "foot_forces")],
)
def test_what_it_does_not_measure_is_not_published(left_out: str, topic: str) -> None:
    found = as_rosbags_reads(published.MEASURED.model_copy(update={left_out: None}))
    assert found.keys() == MEASURED.keys() - {topic}


# ---- a calibrated robot's frames in users' angles, by what was published before them


MIRRORED = RobotCalibration(1, {31: ServoMapping(7_50), 32: ServoMapping(-10_00, inverted=True)})
OTHER = RobotCalibration(2, {31: ServoMapping(-20_00)})
USERS = OneLeg(3, (ServoOp(Op.SET, 90_00), ServoOp(Op.SET, 45_00), ServoOp(Op.START, 120_00)))


def frame(calibration: RobotCalibration, users: Frame = USERS) -> RecordedMessage:
    """Return a frame as it was written with this calibration in force."""
    return RecordedMessage(FRAME, {"bytes": calibration.frame(users).data.hex(), "cause": "command"}, 0)


def state(revision: int | None) -> RecordedMessage:
    content: dict[str, Any] = {} if revision is None else {"calibration": {"revision": revision}}
    return RecordedMessage(STATE, content, 0)


def told(calibration: RobotCalibration) -> RecordedMessage:
    return RecordedMessage(CALIBRATION, report_of(calibration).model_dump(mode="json"), 0)


def read(*messages: RecordedMessage) -> list[Frame]:
    return [found for _, found in frames_in(messages)]


def test_each_frame_is_read_by_the_calibration_before_it() -> None:
    stop = stop_leg(3)
    found = read(
        state(0), frame(RobotCalibration()), told(MIRRORED), state(1), frame(MIRRORED), told(OTHER), frame(OTHER),
        frame(OTHER, stop), frame(OTHER, OneServo(31, ServoOp(Op.SET, 30_00))),
    )  # fmt: skip
    assert found == [USERS, USERS, USERS, stop, OneServo(31, ServoOp(Op.SET, 30_00))]


@pytest.mark.parametrize(
    "message",
    [
        state(1),
        RecordedMessage(CALIBRATION, {"revision": "x"}, 0),
        RecordedMessage(CALIBRATION, {"revision": 1, "servos": {"99": {}}, "landing": {}}, 0),
    ],
    ids=["state without", "no calibration", "no servo"],
)
def test_where_the_calibration_in_force_is_unknown_it_is_known_to_be(message: RecordedMessage) -> None:
    angles = UserAngles()
    angles.take(message.topic, message.content)
    assert not angles.consistent
    assert angles.frame(frame(MIRRORED).content) == MIRRORED.frame(USERS), "as on the wire"
    angles.take(CALIBRATION, told(MIRRORED).content)
    assert angles.consistent


def test_bytes_that_no_user_meant_stay_as_they_are() -> None:
    low = OneServo(31, ServoOp(Op.SET, 0))  # its user would have said -7.5
    assert read(told(MIRRORED), RecordedMessage(FRAME, {"bytes": low.data.hex()}, 0)) == [low]
    assert read(told(MIRRORED), RecordedMessage(FRAME, {"bytes": "00"}, 0)) == []


def test_what_cannot_be_written_is_reported() -> None:
    short = Imu(orientation_covariance=(0.0,) * 8)
    for message in (String("\ud800"), Time(2**31, 0), Duration(0, -1), short):
        with pytest.raises(ValueError, match="cannot be written"):
            encode(message)


# ---- who sends


A, B = b"a", b"b"


def test_an_error_in_one_message_does_not_end_the_topic(caplog: pytest.LogCaptureFixture) -> None:
    taken: list[int] = []

    def take(number: int) -> None:
        taken.append(10 // number)

    with caplog.at_level(logging.ERROR):
        read_each([5, 0, 2], take)
    assert taken == [2, 5]
    assert "a message could not be handled" in caplog.text


def test_the_first_is_followed_until_it_is_silent() -> None:
    rivals = Rivals()
    assert rivals.may_send(B, 0.0), "nobody has sent"
    rivals.sent(A, 10.0)
    assert rivals.may_send(A, 10.1)
    assert not rivals.may_send(B, 10.1)
    rivals.sent(A, 10.2)
    assert not rivals.may_send(B, 10.2 + SILENT_S)
    assert rivals.may_send(B, 10.3 + SILENT_S)
    rivals.sent(B, 10.3 + SILENT_S)
    assert not rivals.may_send(A, 10.4 + SILENT_S), "and now the other"


SHAPE = load()
NAMES = JointNames()
LEG = (11, 12, 13)
REST = (0.0, 0.5, -1.5)

# ---- joints


NO_PATTERNS = ("", "joint", "leg{leg}", "{joint}", "{leg}{joint}{}", "{leg.__class__}{joint}", "a<b")


@pytest.mark.parametrize(
    ("call", "names", "why"),
    [
        (NAMES.servos, (), "names no joint"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_13", "gripper"), "no joint 'gripper'"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_14"), "no joint 'joint_14'"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_13", "joint_12"), "joint_12 twice"),
        (NAMES.servos, ("joint_11", "joint_13"), "of leg 1 it lacks joint_12"),
        (NAMES.servos, ("joint_71",), "no joint 'joint_71'"),
        *((JointNames, each, "no pattern of joint names|gives two joints one name") for each in NO_PATTERNS),
    ],
)
def test_names_and_patterns_that_are_not_taken(call: Callable[[Any], object], names: object, why: str) -> None:
    with pytest.raises(JointsError, match=why):
        call(names)


# ---- positions


@pytest.mark.parametrize(
    ("position", "why"),
    [
        (REST[:2], "there must be one position for each of 3 joints, not 2"),
        ((*REST, 0.0), "there must be one position for each of 3 joints, not 4"),
        *(((0.0, each, -1.5), f"the position of joint_12 is {each}") for each in (math.nan, math.inf, -math.inf)),
    ],
)
def test_a_position_that_is_missing_or_not_finite_is_rejected(position: tuple[float, ...], why: str) -> None:
    with pytest.raises(JointsError, match=why):
        positions_of(LEG, position)


@pytest.mark.parametrize("servo_id", LEG)
@pytest.mark.parametrize(("at_deg", "beyond_deg"), [(0.0, -0.01), (MAX_DEG, MAX_DEG + 0.01)])
def test_a_position_is_taken_up_to_the_servos_range_and_never_clamped(
    servo_id: int, at_deg: float, beyond_deg: float
) -> None:
    at = positions_of(LEG, REST)
    check_reach(SHAPE, at | {servo_id: SHAPE.joint_rad(servo_id, at_deg) * (1 - 1e-9)})
    with pytest.raises(JointsError, match=rf"joint_{servo_id} at .* rad is .*° of its servo, which has 0 to 180°"):
        check_reach(SHAPE, at | {servo_id: SHAPE.joint_rad(servo_id, beyond_deg)})


def test_joints_in_any_order_become_the_degrees_of_their_legs() -> None:
    names = ("joint_63", "joint_12", "joint_61", "joint_13", "joint_62", "joint_11")
    at = positions_of(NAMES.servos(names), (-1.5, 0.5, 0.0, -1.5, 0.5, 0.0))
    degrees = legs_deg(SHAPE, at)
    assert degrees.keys() == {1, 6}
    assert degrees[1] == pytest.approx([SHAPE.servos[name].servo_deg(at[name]) for name in LEG])


# ---- what examples/ros2 configures


FOLDER: Final = Path(__file__).parents[3] / "examples/ros2"
"""Priorities and seconds, as elkapod_core has them."""


def test_what_twist_mux_publishes_is_what_the_bridge_takes() -> None:
    """By DDS a topic has one type: cmd_vel is a Twist."""
    found = YAML(typ="safe").load(FOLDER / "twist_mux.yaml")
    assert found.keys() == {"twist_mux"}
    assert found["twist_mux"]["ros__parameters"]["use_stamped"] is False
    assert "-r cmd_vel_out:=/hexapod/cmd_vel" in (FOLDER / "twist_mux.yaml").read_text()
