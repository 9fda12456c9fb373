"""This robot in ROS 2's messages: what it publishes of itself."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, Final

from gateway.geometry import Geometry, joint_name, transforms, urdf
from gateway.geometry.kinematics import BASE, LINKS, link_name
from gateway.geometry.kinematics import FramePose as Step
from gateway.people.ros2 import messages as ros
from gateway.people.ros2.messages import ERROR, OK, WARN, Header, Marker, Message, Quaternion, Vector3
from gateway.people.walking.motion import Odometry, Velocity
from schemas.gateway_state import GatewayState
from schemas.robot import JOINTS, SERVO_IDS
from schemas.telemetry import Telemetry
from schemas.words import Mode, WatchdogState

UNKNOWN_DEG: Final = 90.0
"""The angle at which a never commanded servo is drawn."""
_HEXAPOD: Final = "hexapod"
_MARK_M: Final = 0.035
"""A little thicker than a drawn leg."""
_OFF: Final = ros.ColorRGBA(0.9, 0.15, 0.1, 0.85)
MEASURED: Final[Mapping[str, type[Message]]] = {
    "battery_state": ros.BatteryState,
    "imu/data": ros.Imu,
    "temperature": ros.Temperature,
    "foot_forces": ros.Float64MultiArray,
}
"""The measurements that a robot may have: topic → type of its messages."""
_MOST_AGE_MS: Final = 60_000.0
"""Most by which a measurement's stamp is put back: without access control anybody may publish any age."""
_MOST_FLOAT32: Final = 3.4e38
_NONE: Final = (-1.0, *(0.0,) * 8)
"""The covariance of a missing value. With unknown accuracy the covariance is all zeros."""
ODOM: Final = "odom"
A_TURN_M: Final = 0.5
"""A radian of turning makes odometry as uncertain as this way: a turn of 69° was off by 3.7° (docs/walking.md)."""
_START_M, _START_RAD, _OFF_COURSE, _TURNED_RAD_M = 0.01, 0.01, 0.1, math.radians(5)
"""Standard deviations of odometry: at its beginning, of a metre's way, and of the heading after it. A simulated robot's
walks are judged by 10 % of the way and 5° (docs/walking.md); that a foot slips is not noticed."""
_SLOW_M_S, _SLOW_RAD_S, _OFF_SPEED = 0.01, 0.02, 0.2
"""Standard deviations of its velocity, which is uneven within a step."""
_UNKNOWN: Final = 1e3
_LEVELS: Final[dict[str, int]] = {Mode.IDLE: OK, Mode.ACTIVE: OK, Mode.ESTOPPED: ERROR, Mode.BUS_FAULT: ERROR}


def stamp(time_ns: int) -> Message:
    """Return ns since 1970 as a Time; ROS 2's seconds end in 2038, and later times have that last second."""
    sec, nanosec = divmod(time_ns, 1_000_000_000)
    return ros.Time(min(sec, 2**31 - 1), nanosec)


def joint_state(joints_rad: Mapping[int, float], time_ns: int, name_of: Callable[[int], str] = joint_name) -> Message:
    """Return a JointState of the known joints, in the order of their servos' numbers."""
    known = [servo_id for servo_id in SERVO_IDS if servo_id in joints_rad]
    names, at_rad = tuple(map(name_of, known)), tuple(joints_rad[servo_id] for servo_id in known)
    return ros.JointState(Header(stamp(time_ns)), names, at_rad)


def frames(geometry: Geometry, joints_rad: Mapping[int, float], time_ns: int, base: str = BASE) -> Message:
    """Return each leg part's transform in its parent's frame; unknown joints are at 90° of their servo."""
    steps = transforms(geometry, all_at(geometry, UNKNOWN_DEG) | dict(joints_rad))
    return transform_message((step._replace(parent=base) if step.parent == BASE else step for step in steps), time_ns)


def odometry(at: Odometry, velocity: Velocity, way_m: float, time_ns: int, base: str = BASE) -> Message:
    """Return the robot's odometry after `way_m` metres, by its steps. Height and lean are not measured."""
    aside_m, turned_rad = _START_M + _OFF_COURSE * way_m, _START_RAD + _TURNED_RAD_M * way_m
    pose = ros.Pose(ros.Point(at.x_m, at.y_m), _heading(at.heading_rad))
    twist = ros.Twist(Vector3(velocity.forward_m_s, velocity.left_m_s), Vector3(z=velocity.turn_rad_s))
    moves = math.hypot(velocity.forward_m_s, velocity.left_m_s)
    return ros.Odometry(
        Header(stamp(time_ns), ODOM),
        base,
        ros.PoseWithCovariance(pose, _planar(aside_m, turned_rad)),
        ros.TwistWithCovariance(twist, _planar(_SLOW_M_S + _OFF_SPEED * moves, _SLOW_RAD_S + _TURNED_RAD_M * moves)),
    )


def odometry_frame(at: Odometry, time_ns: int, base: str = BASE) -> Message:
    """Return odometry as the transform from `odom` to `base`."""
    heading = _heading(at.heading_rad)
    return transform_message(
        [Step(ODOM, base, (at.x_m, at.y_m, 0.0), (heading.x, heading.y, heading.z, heading.w))], time_ns
    )


def _heading(angle_rad: float) -> Message:
    return Quaternion(0.0, 0.0, math.sin(angle_rad / 2), math.cos(angle_rad / 2))


def _planar(along: float, yaw: float) -> tuple[float, ...]:
    """Return the covariance of these standard deviations along, across and about the upright axis."""
    sigmas = (along, along, _UNKNOWN, _UNKNOWN, _UNKNOWN, yaw)
    return tuple(sigmas[row] ** 2 if row == column else 0.0 for row in range(6) for column in range(6))


def all_at(geometry: Geometry, angle_deg: float) -> dict[int, float]:
    """Return servo → joint radians with each servo at this angle."""
    return {servo_id: geometry.joint_rad(servo_id, angle_deg) for servo_id in SERVO_IDS}


def transform_message(steps: Iterable[Step], time_ns: int) -> Message:
    """Return these transforms as one TFMessage."""
    header_stamp = stamp(time_ns)
    transforms = ((step, ros.Transform(Vector3(*step.translation_m), Quaternion(*step.rotation))) for step in steps)
    return ros.TFMessage(
        tuple(ros.TransformStamped(Header(header_stamp, step.parent), step.child, to) for step, to in transforms)
    )


def servos_off(servos: Collection[int], time_ns: int) -> Message:
    """Return marks on the joints of these servos, and a word at each leg that is off. They replace earlier marks."""
    header_stamp = stamp(time_ns)
    marks = [Marker(Header(header_stamp, BASE), "servos off", action=ros.DELETEALL)]
    shown: dict[str, Any] = {"color": _OFF, "frame_locked": True}
    for servo_id in sorted(servos):
        leg, joint = divmod(servo_id, 10)
        header = Header(header_stamp, link_name(leg, LINKS[joint - 1]))
        size = Vector3(_MARK_M, _MARK_M, _MARK_M)
        marks.append(Marker(header, "servos off", servo_id, ros.SPHERE, scale=size, **shown))
        if joint == 1 and {10 * leg + each for each in JOINTS} <= set(servos):
            word = {"pose": ros.Pose(ros.Point(0.0, 0.0, 2 * _MARK_M), Quaternion(w=1.0)), "text": f"leg {leg} off"}
            size = Vector3(z=_MARK_M)
            marks.append(Marker(header, "servos off", leg, ros.TEXT_VIEW_FACING, scale=size, **word, **shown))
    return ros.MarkerArray(tuple(marks))


def description(geometry: Geometry, name_of: Callable[[int], str] = joint_name, base: str = BASE) -> Message:
    """Return the URDF with the joint names of `joint_state` and the root `base`."""
    text = urdf(geometry)
    for place in ("link name", "parent link"):
        text = text.replace(f'{place}="{BASE}"', f'{place}="{base}"')
    for servo_id in SERVO_IDS:
        text = text.replace(f'name="{joint_name(servo_id)}"', f'name="{name_of(servo_id)}"')
    return ros.String(text)


def measured(found: Telemetry, time_ns: int, base: str = BASE, imu_frame: str = BASE) -> Iterator[tuple[str, Message]]:
    """Return topics and messages of the robot's measurements, received at `time_ns`.

    The robot reports neither its sensors' accuracy, nor where they are: they count as the body's own. ROS 2's
    percentage is a part of 1; an unknown value is NaN.
    """
    header = Header(stamp(time_ns - round(min(found.age_ms, _MOST_AGE_MS) * 1_000_000)), base)
    if found.battery is not None:
        voltage_v, percent = found.battery.voltage_v, found.battery.percent
        yield (
            "battery_state",
            ros.BatteryState(
                header,
                voltage=voltage_v if abs(voltage_v) < _MOST_FLOAT32 else math.nan,
                **dict.fromkeys(("temperature", "current", "charge", "capacity", "design_capacity"), math.nan),
                percentage=percent / 100 if percent is not None and 0 <= percent <= 100 else math.nan,
                present=True,
            ),
        )
    if (imu := found.imu) is not None:
        w, x, y, z = imu.orientation_wxyz
        yield (
            "imu/data",
            ros.Imu(
                Header(header.stamp, imu_frame),
                Quaternion(x, y, z, w),
                orientation_covariance=_NONE if found.tilt_deg is None else (0.0,) * 9,  # no tilt: no orientation yet
                angular_velocity=Vector3(*imu.angular_velocity_rad_s),
                linear_acceleration=Vector3(*imu.linear_acceleration_m_s2),
            ),
        )
    if found.temperature_c is not None:
        yield "temperature", ros.Temperature(header, found.temperature_c)
    if (feet := found.feet) is not None:
        legs = ros.MultiArrayDimension("leg", len(feet), len(feet))
        yield "foot_forces", ros.Float64MultiArray(ros.MultiArrayLayout((legs,)), feet)


def diagnostics(state: GatewayState) -> tuple[Message, ...]:
    """Return a DiagnosticStatus for each part of the gateway."""
    expired = [leg.leg for leg in state.legs if leg.watchdog == WatchdogState.EXPIRED]
    fault, estopped, lease = state.mode == Mode.BUS_FAULT, state.mode == Mode.ESTOPPED, state.lease
    latency_us = state.watchdog.stop_latency_us.model_dump()
    commands = state.commands.model_dump(include={"accepted", "rejected"})
    parts: tuple[tuple[str, int, str, dict[str, object]], ...] = (
        (
            "gateway",
            _LEVELS.get(state.mode, WARN),
            state.mode,
            state.model_dump(include={"mode", "version", "simulated"})
            | {f"commands_{name}": count for name, count in commands.items()},
        ),
        (
            "watchdog",
            WARN if expired else OK,
            f"it has stopped leg {', '.join(map(str, expired))}" if expired else "no leg is stopped by it",
            state.watchdog.model_dump(include={"timeout_ms", "expirations"})
            | {f"stop_latency_{name}_us": value for name, value in latency_us.items()},
        ),
        (
            "bus",
            ERROR if fault else OK,
            "it does not answer" if fault else "it answers",
            state.spi.model_dump(include={"device", "frames", "errors"}) | {"controller_alive": state.controller.alive},
        ),
        (
            "emergency stop",
            ERROR if estopped else OK,
            f"engaged by {state.estop_source or 'somebody'}" if estopped else "not engaged",
            {"number": state.estop, "source": state.estop_source},
        ),
        (
            "lease",
            OK,
            "nobody drives" if lease.holder is None else f"{lease.holder} drives",
            lease.model_dump(include={"holder", "verified", "asked_by"}),
        ),
    )
    return tuple(status(part, level, message, **values) for part, level, message, values in parts)


def status(part: str, level: int, message: str, **values: object) -> Message:
    """Return the DiagnosticStatus of one part. Values that are None are omitted."""
    shown = tuple(ros.KeyValue(key, _text(value)) for key, value in values.items() if value is not None)
    return ros.DiagnosticStatus(level, f"{_HEXAPOD}: {part}", _text(message), _HEXAPOD, shown)


def diagnostic_array(statuses: tuple[Message, ...], time_ns: int, hardware_id: str = _HEXAPOD) -> Message:
    """Return the statuses as one message of `/diagnostics`; `hardware_id` names this robot."""
    for each in statuses:
        each.hardware_id = hardware_id
    return ros.DiagnosticArray(Header(stamp(time_ns)), statuses)


def _text(value: object) -> str:
    """Return the text without zeros, which a CDR string cannot have: it contains foreign names."""
    return str(value).replace("\0", "\ufffd")
