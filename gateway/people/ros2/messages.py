"""ROS 2's messages, as values: the fields that are written here, by ROS 2's names. Others have ROS 2's defaults.

`cdr` writes these messages for a recording, by rosbags; the node hands them to rclpy.
"""

from types import SimpleNamespace
from typing import Any, ClassVar, Final


class Message(SimpleNamespace):
    """A message, of a type that `message_type` has made, with the fields that are set. Sequences are tuples."""

    TYPE: ClassVar[str]
    """The type's name in ROS 2, such as `std_msgs/msg/String`."""
    FIELDS: ClassVar[tuple[str, ...]]

    def __init__(self, *values: Any, **fields: Any) -> None:
        """Raises TypeError for a field that the type does not have."""
        fields |= zip(self.FIELDS, values, strict=False)
        if len(values) > len(self.FIELDS) or not fields.keys() <= set(self.FIELDS):
            raise TypeError(f"{self.TYPE} has the fields {', '.join(self.FIELDS)}")
        super().__init__(**fields)


def message_type(type_name: str, fields: str, module: str = __name__) -> type[Message]:
    """Return a message type with these fields, in their order. `module` must hold it under its own name."""
    made = {"__module__": module, "TYPE": type_name, "FIELDS": tuple(fields.split())}
    return type(type_name.rpartition("/")[2], (Message,), made)


OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Levels of a DiagnosticStatus."""
LOG_INFO, LOG_WARN, LOG_ERROR = 20, 30, 40
SPHERE, TEXT_VIEW_FACING = 2, 9
"""Types of a Marker."""
DELETEALL: Final = 3
"""An action of a Marker."""

Time: Final = message_type("builtin_interfaces/msg/Time", "sec nanosec")
String: Final = message_type("std_msgs/msg/String", "data")
Header: Final = message_type("std_msgs/msg/Header", "stamp frame_id")
ColorRGBA: Final = message_type("std_msgs/msg/ColorRGBA", "r g b a")
MultiArrayDimension: Final = message_type("std_msgs/msg/MultiArrayDimension", "label size stride")
MultiArrayLayout: Final = message_type("std_msgs/msg/MultiArrayLayout", "dim")
Float64MultiArray: Final = message_type("std_msgs/msg/Float64MultiArray", "layout data")
Log: Final = message_type("rcl_interfaces/msg/Log", "stamp level name msg")

Point: Final = message_type("geometry_msgs/msg/Point", "x y z")
Vector3: Final = message_type("geometry_msgs/msg/Vector3", "x y z")
Quaternion: Final = message_type("geometry_msgs/msg/Quaternion", "x y z w")
Pose: Final = message_type("geometry_msgs/msg/Pose", "position orientation")
Transform: Final = message_type("geometry_msgs/msg/Transform", "translation rotation")
PoseWithCovariance: Final = message_type("geometry_msgs/msg/PoseWithCovariance", "pose covariance")
Twist: Final = message_type("geometry_msgs/msg/Twist", "linear angular")
TwistWithCovariance: Final = message_type("geometry_msgs/msg/TwistWithCovariance", "twist covariance")
Odometry: Final = message_type("nav_msgs/msg/Odometry", "header child_frame_id pose twist")
TransformStamped: Final = message_type("geometry_msgs/msg/TransformStamped", "header child_frame_id transform")
TFMessage: Final = message_type("tf2_msgs/msg/TFMessage", "transforms")

JointState: Final = message_type("sensor_msgs/msg/JointState", "header name position")
CompressedImage: Final = message_type("sensor_msgs/msg/CompressedImage", "header format data")
Temperature: Final = message_type("sensor_msgs/msg/Temperature", "header temperature")
BatteryState: Final = message_type(
    "sensor_msgs/msg/BatteryState",
    "header voltage temperature current charge capacity design_capacity percentage present",
)
Imu: Final = message_type(
    "sensor_msgs/msg/Imu", "header orientation orientation_covariance angular_velocity linear_acceleration"
)

KeyValue: Final = message_type("diagnostic_msgs/msg/KeyValue", "key value")
DiagnosticStatus: Final = message_type("diagnostic_msgs/msg/DiagnosticStatus", "level name message hardware_id values")
DiagnosticArray: Final = message_type("diagnostic_msgs/msg/DiagnosticArray", "header status")

Marker: Final = message_type(
    "visualization_msgs/msg/Marker", "header ns id type action pose scale color frame_locked text"
)
MarkerArray: Final = message_type("visualization_msgs/msg/MarkerArray", "markers")
