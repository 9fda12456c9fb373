"""What the robot publishes of itself in ROS 2, from every state that a gateway has ever published."""

import math
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.geometry import foot_m, load
from gateway.geometry.kinematics import Quaternion, Vector, plus, rotated, times
from gateway.people.ros2.cdr import encode
from gateway.people.ros2.joints import JointNames
from gateway.people.ros2.messages import DiagnosticArray, DiagnosticStatus, ImuMessage, JointState, Temperature, Time
from gateway.people.ros2.robot import (
    MEASURED,
    description,
    diagnostic_array,
    diagnostics,
    frames,
    joint_state,
    measured,
    stamp,
    status,
)
from schemas.robot import SERVO_IDS
from schemas.telemetry import Battery, GatewayState, Mode, Telemetry
from tests.support import measuring
from tests.support.ros2_bytes import STORE, decode

WIRE: Final = Path(__file__).parents[2] / "data/wire"
STATES: Final = {
    line: GatewayState.model_validate_json(line)
    for file in sorted(WIRE.glob("*/state.jsonl"))
    for line in file.read_text().splitlines()
}
GEOMETRY: Final = load()
NOW_NS: Final = 1_700_000_000_123_456_789


@pytest.mark.parametrize("state", STATES.values(), ids=range(len(STATES)))
def test_every_state_has_diagnostics(state: GatewayState) -> None:
    found = diagnostic_array(diagnostics(state), NOW_NS)
    assert decode(DiagnosticArray, encode(found)) == found
    others = diagnostic_array(diagnostics(state), NOW_NS, "fleet/robot_1").status
    assert {each.hardware_id for each in others} == {"fleet/robot_1"}
    gateway = found.status[0]
    assert gateway.message == state.mode
    assert (gateway.level == DiagnosticStatus.OK) == (state.mode in (Mode.IDLE, Mode.ACTIVE))
    assert (gateway.level == DiagnosticStatus.ERROR) == (state.mode in (Mode.ESTOPPED, Mode.BUS_FAULT))


def test_a_mode_of_a_later_gateway_is_a_warning() -> None:
    (state, *_) = STATES.values()
    (gateway, *_) = diagnostics(state.model_copy(update={"mode": "dancing"}))
    assert (gateway.level, gateway.message) == (DiagnosticStatus.WARN, "dancing")


def test_a_strangers_name_breaks_no_message() -> None:
    found = status("lease", 0, "a\0b drives", holder="a\0b", verified=None)
    assert [value.key for value in found.values] == ["holder"]
    assert decode(DiagnosticStatus, encode(found)) == found


def test_joint_states_are_in_the_order_of_the_urdf_and_leave_out_what_is_not_known() -> None:
    found = joint_state({63: 0.5, 11: 0.25}, NOW_NS)
    assert (found.name, found.position) == (("joint_11", "joint_63"), (0.25, 0.5))
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == divmod(NOW_NS, 10**9)
    text = description(GEOMETRY).data
    places = [text.index(f'<joint name="joint_{servo_id}"') for servo_id in SERVO_IDS]
    assert places == sorted(places)
    assert joint_state({}, NOW_NS) == JointState(found.header)


def test_other_joint_names_are_those_of_the_urdf_too() -> None:
    names = JointNames("leg{leg}_J{joint}")
    assert joint_state({11: 0.25}, NOW_NS, names.of).name == ("leg1_J1",)
    text = description(GEOMETRY, names.of).data
    assert all(f'<joint name="{names.of(servo_id)}"' in text for servo_id in SERVO_IDS)
    assert "joint_11" not in text


def test_frames_are_named_as_another_stack_names_them() -> None:
    text = description(GEOMETRY, base="base_link").data
    assert text.count('"base_link"') == 1 + 6, "the root, and the parent of each leg"
    assert '"base"' not in text
    steps = frames(GEOMETRY, {}, NOW_NS, "base_link").transforms
    assert sum(step.header.frame_id == "base_link" for step in steps) == 6
    assert not any("base" in (step.header.frame_id, step.child_frame_id) for step in steps)
    found = dict(measured(measuring.MEASURED, NOW_NS, "base_link", "imu_link"))
    assert {
        topic: each.header.frame_id for topic, each in found.items() if isinstance(each, ImuMessage | Temperature)
    } == {
        "imu/data": "imu_link",
        "temperature": "base_link",
    }


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
        assert at_m == pytest.approx(foot_m(GEOMETRY, leg, joints_rad))


def test_a_time_beyond_those_of_ros_2_is_its_last() -> None:
    assert stamp(1_700_000_000_000_000_005) == Time(1_700_000_000, 5)
    assert stamp(2**63) == Time(2**31 - 1, 2**63 % 10**9)


def as_rosbags_reads(found: Telemetry) -> dict[str, Any]:
    return {
        topic: STORE.deserialize_cdr(encode(message), message.TYPE)
        for topic, message in measured(found, NOW_NS)
        if isinstance(message, MEASURED[topic])
    }


def test_what_it_measures_is_in_ros_2s_units_and_what_nobody_knows_is_nan() -> None:
    found = as_rosbags_reads(measuring.MEASURED)
    assert found.keys() == MEASURED.keys()
    battery, imu, temperature = found["battery_state"], found["imu/data"], found["temperature"]
    assert (battery.voltage, battery.percentage, battery.present) == (pytest.approx(7.4), pytest.approx(0.8), True)
    unknown = (battery.temperature, battery.current, battery.charge, battery.capacity, battery.design_capacity)
    assert all(map(math.isnan, unknown))
    assert (battery.power_supply_status, battery.power_supply_health, battery.power_supply_technology) == (0, 0, 0)
    assert (imu.orientation.w, imu.orientation.x) == (1.0, 0.0)
    assert (imu.angular_velocity.z, imu.linear_acceleration.z) == (0.5, 9.81)
    covariances = (
        imu.orientation_covariance,
        imu.angular_velocity_covariance,
        imu.linear_acceleration_covariance,
    )
    assert [each.tolist() for each in covariances] == [[0.0] * 9] * 3
    assert (temperature.temperature, temperature.variance) == (31.5, 0.0)
    assert found["foot_forces"].data.tolist() == list(measuring.MEASURED.feet or ())
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
    found = as_rosbags_reads(measuring.MEASURED.model_copy(update={left_out: None}))
    assert found.keys() == MEASURED.keys() - {topic}


def test_an_orientation_that_is_none_is_marked_as_none() -> None:
    found = as_rosbags_reads(measuring.MEASURED.model_copy(update={"tilt_deg": None}))
    assert found["imu/data"].orientation_covariance.tolist() == [-1.0] + [0.0] * 8
    assert found["imu/data"].linear_acceleration_covariance.tolist() == [0.0] * 9


@pytest.mark.parametrize("percent", [-0.1, 100.1, math.nan, math.inf])
def test_a_strangers_measurement_breaks_no_message(percent: float) -> None:
    update = {"battery": Battery(voltage_v=1e300, percent=percent), "age_ms": math.inf}
    battery = as_rosbags_reads(measuring.MEASURED.model_copy(update=update))["battery_state"]
    assert math.isnan(battery.voltage)
    assert math.isnan(battery.percentage)
