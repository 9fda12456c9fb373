"""This robot in ROS 2's messages: what it publishes of itself."""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

from gateway.geometry import Geometry, joint_name, transforms, urdf
from gateway.geometry.kinematics import BASE, LINKS, link_name
from gateway.geometry.kinematics import FramePose as Step
from gateway.people.ros2.messages import (
    BatteryState,
    ColorRGBA,
    DiagnosticArray,
    DiagnosticStatus,
    Float64MultiArray,
    Header,
    ImuMessage,
    JointState,
    KeyValue,
    Marker,
    MarkerArray,
    Message,
    MultiArrayDimension,
    MultiArrayLayout,
    Point,
    Pose,
    Quaternion,
    String,
    Temperature,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
)
from schemas.robot import JOINTS, SERVO_IDS
from schemas.telemetry import Battery, GatewayState, Mode, Telemetry, WatchdogState

UNKNOWN_DEG: Final = 90.0
"""Where a servo that was never commanded is drawn."""
_HEXAPOD: Final = "hexapod"
_MARK_M: Final = 0.035
"""A little thicker than a leg is drawn."""
_OFF: Final = ColorRGBA(0.9, 0.15, 0.1, 0.85)
_OK, _WARN, _ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
MEASURED: Final[Mapping[str, type[Message]]] = {
    "battery_state": BatteryState,
    "imu/data": ImuMessage,
    "temperature": Temperature,
    "foot_forces": Float64MultiArray,
}
"""Topic → the type of its messages: what a robot may measure."""
_MOST_AGE_MS: Final = 60_000.0
"""By which a measurement's stamp is put back; without access control anybody may publish any age."""
_MOST_FLOAT32: Final = 3.4e38
_NONE: Final = (-1.0, *(0.0,) * 8)
"""The covariance of a value that is none; that of one whose accuracy is not known is all zeros."""
_LEVELS: Final[dict[str, int]] = {Mode.IDLE: _OK, Mode.ACTIVE: _OK, Mode.ESTOPPED: _ERROR, Mode.BUS_FAULT: _ERROR}


def stamp(time_ns: int) -> Time:
    """A time since 1970; ROS 2's end in 2038, and whatever is later has that last second."""
    sec, nanosec = divmod(time_ns, 1_000_000_000)
    return Time(min(sec, 2**31 - 1), nanosec)


def joint_state(
    joints_rad: Mapping[int, float], time_ns: int, name_of: Callable[[int], str] = joint_name
) -> JointState:
    """The joints that are known, by their servos' numbers."""
    known = [servo_id for servo_id in SERVO_IDS if servo_id in joints_rad]
    return JointState(
        Header(stamp(time_ns)),
        tuple(map(name_of, known)),
        tuple(joints_rad[servo_id] for servo_id in known),
    )


def frames(geometry: Geometry, joints_rad: Mapping[int, float], time_ns: int, base: str = BASE) -> TFMessage:
    """Where each part of each leg is, in its parent's frame. A joint that is not known is drawn at 90° of its servo."""
    steps = transforms(geometry, all_at(geometry, UNKNOWN_DEG) | dict(joints_rad))
    return transform_message((step._replace(parent=base) if step.parent == BASE else step for step in steps), time_ns)


def all_at(geometry: Geometry, angle_deg: float) -> dict[int, float]:
    """The joints with each servo at this angle."""
    return {servo_id: geometry.joint_rad(servo_id, angle_deg) for servo_id in SERVO_IDS}


def transform_message(steps: Iterable[Step], time_ns: int) -> TFMessage:
    """These frames, each in its parent's."""
    header_stamp = stamp(time_ns)
    return TFMessage(
        tuple(
            TransformStamped(
                Header(header_stamp, step.parent),
                step.child,
                Transform(Vector3(*step.translation_m), Quaternion(*step.rotation)),
            )
            for step in steps
        )
    )


def servos_off(servos: Collection[int], time_ns: int) -> MarkerArray:
    """Marks on the joints of these servos, in place of any before; and the word, at a leg whose servos are all off."""
    header_stamp = stamp(time_ns)
    marks = [Marker(Header(header_stamp, BASE), "servos off", action=Marker.DELETEALL)]
    for servo_id in sorted(servos):
        leg, joint = divmod(servo_id, 10)
        header = Header(header_stamp, link_name(leg, LINKS[joint - 1]))
        size = Vector3(_MARK_M, _MARK_M, _MARK_M)
        marks.append(Marker(header, "servos off", servo_id, Marker.SPHERE, scale=size, color=_OFF, frame_locked=True))
        if joint == 1 and {10 * leg + each for each in JOINTS} <= set(servos):
            above = Pose(Point(0.0, 0.0, 2 * _MARK_M), Quaternion(w=1.0))
            marks.append(
                Marker(
                    header, "servos off", leg, Marker.TEXT_VIEW_FACING, pose=above, scale=Vector3(z=_MARK_M),
                    color=_OFF, frame_locked=True, text=f"leg {leg} off",
                )
            )  # fmt: skip
    return MarkerArray(tuple(marks))


def description(geometry: Geometry, name_of: Callable[[int], str] = joint_name, base: str = BASE) -> String:
    """The URDF, whose joints are those of `joint_state`, and whose root is `base`."""
    text = urdf(geometry)
    for place in ("link name", "parent link"):
        text = text.replace(f'{place}="{BASE}"', f'{place}="{base}"')
    for servo_id in SERVO_IDS:
        text = text.replace(f'name="{joint_name(servo_id)}"', f'name="{name_of(servo_id)}"')
    return String(text)


def measured(found: Telemetry, time_ns: int, base: str = BASE, imu_frame: str = BASE) -> Iterator[tuple[str, Message]]:
    """The topics and messages of what the robot measures; `time_ns` is when it was received.

    The robot says nothing of its sensors' accuracy, and nothing of where they are: they count as the body's own.
    """
    header = Header(stamp(time_ns - round(min(found.age_ms, _MOST_AGE_MS) * 1_000_000)), base)
    if found.battery is not None:
        yield "battery_state", _battery(found.battery, header)
    if (imu := found.imu) is not None:
        w, x, y, z = imu.orientation_wxyz
        yield (
            "imu/data",
            ImuMessage(
                Header(header.stamp, imu_frame),
                Quaternion(x, y, z, w),
                orientation_covariance=_NONE if found.tilt_deg is None else (0.0,) * 9,  # no tilt: no orientation yet
                angular_velocity=Vector3(*imu.angular_velocity_rad_s),
                linear_acceleration=Vector3(*imu.linear_acceleration_m_s2),
            ),
        )
    if found.temperature_c is not None:
        yield "temperature", Temperature(header, found.temperature_c)
    if (feet := found.feet) is not None:
        yield (
            "foot_forces",
            Float64MultiArray(MultiArrayLayout((MultiArrayDimension("leg", len(feet), len(feet)),)), feet),
        )


def _battery(battery: Battery, header: Header) -> BatteryState:
    """ROS 2's percentage is a part of 1; an unknown value is NaN."""
    unknown = math.nan
    return BatteryState(
        header,
        voltage=battery.voltage_v if abs(battery.voltage_v) < _MOST_FLOAT32 else unknown,
        temperature=unknown,
        current=unknown,
        charge=unknown,
        capacity=unknown,
        design_capacity=unknown,
        percentage=battery.percent / 100 if 0 <= battery.percent <= 100 else unknown,
        present=True,
    )


def diagnostics(state: GatewayState) -> tuple[DiagnosticStatus, ...]:
    """What the gateway publishes of itself, a status for each part."""
    expired = [leg.leg for leg in state.legs if leg.watchdog == WatchdogState.EXPIRED]
    latency, lease, estopped = state.watchdog.stop_latency_us, state.lease, state.mode == Mode.ESTOPPED
    return (
        status(
            "gateway",
            _LEVELS.get(state.mode, _WARN),
            state.mode,
            mode=state.mode,
            version=state.version,
            simulated=state.simulated,
            commands_accepted=state.commands.accepted,
            commands_rejected=state.commands.rejected,
        ),
        status(
            "watchdog",
            _WARN if expired else _OK,
            f"it has stopped leg {', '.join(map(str, expired))}" if expired else "no leg is stopped by it",
            timeout_ms=state.watchdog.timeout_ms,
            expirations=state.watchdog.expirations,
            stop_latency_p50_us=latency.p50,
            stop_latency_p99_us=latency.p99,
            stop_latency_max_us=latency.max,
        ),
        status(
            "bus",
            _ERROR if state.mode == Mode.BUS_FAULT else _OK,
            "it does not answer" if state.mode == Mode.BUS_FAULT else "it answers",
            device=state.spi.device,
            frames=state.spi.frames,
            errors=state.spi.errors,
            controller_alive=state.controller.alive,
        ),
        status(
            "emergency stop",
            _ERROR if estopped else _OK,
            f"engaged by {state.estop_source or 'somebody'}" if estopped else "not engaged",
            number=state.estop,
            source=state.estop_source,
        ),
        status(
            "lease",
            _OK,
            "nobody drives" if lease.holder is None else f"{lease.holder} drives",
            holder=lease.holder,
            verified=lease.verified,
            asked_by=lease.asked_by,
        ),
    )


def status(part: str, level: int, message: str, **values: object) -> DiagnosticStatus:
    """One part's; a value that is None is left out."""
    shown = tuple(KeyValue(key, _text(value)) for key, value in values.items() if value is not None)
    return DiagnosticStatus(level, f"{_HEXAPOD}: {part}", _text(message), _HEXAPOD, shown)


def diagnostic_array(
    statuses: tuple[DiagnosticStatus, ...], time_ns: int, hardware_id: str = _HEXAPOD
) -> DiagnosticArray:
    """The robot's diagnostics as one message of `/diagnostics`; `hardware_id` tells it from others."""
    return DiagnosticArray(Header(stamp(time_ns)), tuple(replace(each, hardware_id=hardware_id) for each in statuses))


def _text(value: object) -> str:
    """Without the zeros that a CDR string cannot have: a stranger's name is in it."""
    return str(value).replace("\0", "�")
