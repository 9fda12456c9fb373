"""ROS 2's messages, as values: the fields that are written or read here, by ROS 2's names.

Other fields have ROS 2's defaults. `cdr` writes these messages for a recording, by rosbags; the bridge hands them to
rclpy.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple, TypeVar, dataclass_transform, get_args, get_origin, get_type_hints


class Field(NamedTuple):
    """One field of a message."""

    name: str
    inner: "type[Message] | None" = None
    """The message inside; None: numbers, or text."""
    many: bool = False
    """Whether it is a sequence, or an array."""


@dataclass(frozen=True, slots=True)
class Message:
    """A message, made by `ros_msg`. Sequences are tuples."""

    TYPE: ClassVar[str]
    """As ROS 2 names it, such as `std_msgs/msg/String`."""
    FIELDS: ClassVar[tuple[Field, ...]]


M = TypeVar("M", bound=Message)


@dataclass_transform(frozen_default=True)
def ros_msg(type_name: str) -> Callable[[type[M]], type[M]]:
    """Make a class a frozen dataclass, and this type of ROS 2's."""

    def declare(cls: type[M]) -> type[M]:
        made = dataclass(frozen=True, slots=True)(cls)
        made.TYPE = type_name
        hints = get_type_hints(made)
        made.FIELDS = tuple(_field(each.name, hints[each.name]) for each in fields(made))
        return made

    return declare


def _field(name: str, hint: Any) -> Field:
    many = get_origin(hint) is tuple
    inner = get_args(hint)[0] if many else hint
    return Field(name, inner if issubclass(inner, Message) else None, many)


@ros_msg("std_msgs/msg/String")
class String(Message):
    data: str = ""


@ros_msg("std_msgs/msg/Int32")
class Int32(Message):
    data: int = 0


@ros_msg("std_msgs/msg/Float64")
class Float64(Message):
    data: float = 0.0


@ros_msg("std_msgs/msg/MultiArrayDimension")
class MultiArrayDimension(Message):
    label: str = ""
    size: int = 0
    stride: int = 0


@ros_msg("std_msgs/msg/MultiArrayLayout")
class MultiArrayLayout(Message):
    dim: tuple[MultiArrayDimension, ...] = ()


@ros_msg("std_msgs/msg/Float64MultiArray")
class Float64MultiArray(Message):
    layout: MultiArrayLayout = MultiArrayLayout()
    data: tuple[float, ...] = ()


@ros_msg("builtin_interfaces/msg/Time")
class Time(Message):
    sec: int = 0
    nanosec: int = 0


@ros_msg("std_msgs/msg/Header")
class Header(Message):
    stamp: Time = Time()
    frame_id: str = ""


@ros_msg("sensor_msgs/msg/JointState")
class JointState(Message):
    header: Header = Header()
    name: tuple[str, ...] = ()
    position: tuple[float, ...] = ()


@ros_msg("diagnostic_msgs/msg/KeyValue")
class KeyValue(Message):
    key: str = ""
    value: str = ""


@ros_msg("diagnostic_msgs/msg/DiagnosticStatus")
class DiagnosticStatus(Message):
    OK: ClassVar = 0
    WARN: ClassVar = 1
    ERROR: ClassVar = 2
    STALE: ClassVar = 3

    level: int = 0
    name: str = ""
    message: str = ""
    hardware_id: str = ""
    values: tuple[KeyValue, ...] = ()


@ros_msg("diagnostic_msgs/msg/DiagnosticArray")
class DiagnosticArray(Message):
    header: Header = Header()
    status: tuple[DiagnosticStatus, ...] = ()


@ros_msg("geometry_msgs/msg/Vector3")
class Vector3(Message):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@ros_msg("geometry_msgs/msg/Twist")
class Twist(Message):
    linear: Vector3 = Vector3()
    angular: Vector3 = Vector3()


@ros_msg("geometry_msgs/msg/TwistStamped")
class TwistStamped(Message):
    header: Header = Header()
    twist: Twist = Twist()


@ros_msg("geometry_msgs/msg/Quaternion")
class Quaternion(Message):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 0.0


@ros_msg("geometry_msgs/msg/Transform")
class Transform(Message):
    translation: Vector3 = Vector3()
    rotation: Quaternion = Quaternion()


@ros_msg("geometry_msgs/msg/TransformStamped")
class TransformStamped(Message):
    header: Header = Header()
    child_frame_id: str = ""
    transform: Transform = Transform()


@ros_msg("tf2_msgs/msg/TFMessage")
class TFMessage(Message):
    transforms: tuple[TransformStamped, ...] = ()


@ros_msg("builtin_interfaces/msg/Duration")
class Duration(Message):
    sec: int = 0
    nanosec: int = 0


@ros_msg("trajectory_msgs/msg/JointTrajectoryPoint")
class JointTrajectoryPoint(Message):
    positions: tuple[float, ...] = ()
    velocities: tuple[float, ...] = ()
    accelerations: tuple[float, ...] = ()
    time_from_start: Duration = Duration()


@ros_msg("trajectory_msgs/msg/JointTrajectory")
class JointTrajectory(Message):
    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    points: tuple[JointTrajectoryPoint, ...] = ()


@ros_msg("rcl_interfaces/msg/Log")
class Log(Message):
    INFO: ClassVar = 20
    WARN: ClassVar = 30
    ERROR: ClassVar = 40

    stamp: Time = Time()
    level: int = 0
    name: str = ""
    msg: str = ""


@ros_msg("geometry_msgs/msg/Point")
class Point(Message):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@ros_msg("geometry_msgs/msg/Pose")
class Pose(Message):
    position: Point = Point()
    orientation: Quaternion = Quaternion()


@ros_msg("std_msgs/msg/ColorRGBA")
class ColorRGBA(Message):
    r: float = 0.0
    g: float = 0.0
    b: float = 0.0
    a: float = 0.0


@ros_msg("visualization_msgs/msg/Marker")
class Marker(Message):
    SPHERE: ClassVar = 2
    TEXT_VIEW_FACING: ClassVar = 9
    DELETEALL: ClassVar = 3

    header: Header = Header()
    ns: str = ""
    id: int = 0
    type: int = 0
    action: int = 0
    pose: Pose = Pose()
    scale: Vector3 = Vector3()
    color: ColorRGBA = ColorRGBA()
    frame_locked: bool = False
    text: str = ""


@ros_msg("visualization_msgs/msg/MarkerArray")
class MarkerArray(Message):
    markers: tuple[Marker, ...] = ()


@ros_msg("sensor_msgs/msg/Imu")
class ImuMessage(Message):
    header: Header = Header()
    orientation: Quaternion = Quaternion()
    orientation_covariance: tuple[float, ...] = (0.0,) * 9
    angular_velocity: Vector3 = Vector3()
    angular_velocity_covariance: tuple[float, ...] = (0.0,) * 9
    linear_acceleration: Vector3 = Vector3()
    linear_acceleration_covariance: tuple[float, ...] = (0.0,) * 9


@ros_msg("sensor_msgs/msg/BatteryState")
class BatteryState(Message):
    header: Header = Header()
    voltage: float = 0.0
    temperature: float = 0.0
    current: float = 0.0
    charge: float = 0.0
    capacity: float = 0.0
    design_capacity: float = 0.0
    percentage: float = 0.0
    present: bool = False


@ros_msg("sensor_msgs/msg/Temperature")
class Temperature(Message):
    header: Header = Header()
    temperature: float = 0.0


# ---- the action FollowJointTrajectory


@ros_msg("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
class MultiDOFJointTrajectoryPoint(Message):
    """Only whether there is one matters."""


@ros_msg("trajectory_msgs/msg/MultiDOFJointTrajectory")
class MultiDOFJointTrajectory(Message):
    points: tuple[MultiDOFJointTrajectoryPoint, ...] = ()


@ros_msg("control_msgs/msg/JointTolerance")
class JointTolerance(Message):
    name: str = ""
    position: float = 0.0


@ros_msg("control_msgs/action/FollowJointTrajectory_Goal")
class FollowGoal(Message):
    trajectory: JointTrajectory = JointTrajectory()
    multi_dof_trajectory: MultiDOFJointTrajectory = MultiDOFJointTrajectory()
    path_tolerance: tuple[JointTolerance, ...] = ()
    goal_tolerance: tuple[JointTolerance, ...] = ()
    goal_time_tolerance: Duration = Duration()


@ros_msg("control_msgs/action/FollowJointTrajectory_Result")
class FollowResult(Message):
    SUCCESSFUL: ClassVar = 0
    INVALID_GOAL: ClassVar = -1
    INVALID_JOINTS: ClassVar = -2
    OLD_HEADER_TIMESTAMP: ClassVar = -3
    PATH_TOLERANCE_VIOLATED: ClassVar = -4
    GOAL_TOLERANCE_VIOLATED: ClassVar = -5

    error_code: int = 0
    error_string: str = ""


@ros_msg("control_msgs/action/FollowJointTrajectory_Feedback")
class FollowFeedback(Message):
    header: Header = Header()
    joint_names: tuple[str, ...] = ()
    desired: JointTrajectoryPoint = JointTrajectoryPoint()
    actual: JointTrajectoryPoint = JointTrajectoryPoint()
    error: JointTrajectoryPoint = JointTrajectoryPoint()
