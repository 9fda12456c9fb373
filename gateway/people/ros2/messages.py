"""ROS 2's messages, as values: the fields that are written here, by ROS 2's names. Others have ROS 2's defaults.

`cdr` writes these messages for a recording, by rosbags; the node hands them to rclpy.
"""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, ClassVar, Final


class Message(SimpleNamespace):
    """A message, of a type that `message_type` has made. Sequences are tuples."""

    TYPE: ClassVar[str]
    """The type's name in ROS 2, such as `std_msgs/msg/String`."""
    FIELDS: ClassVar[Mapping[str, Any]]
    """Field → its default, in their order."""

    def __init__(self, *values: Any, **fields: Any) -> None:
        """Raises TypeError for a field that the type does not have."""
        set_fields = dict(zip(self.FIELDS, values, strict=False)) | fields
        if len(values) > len(self.FIELDS) or not set_fields.keys() <= self.FIELDS.keys():
            raise TypeError(f"{self.TYPE} has the fields {', '.join(self.FIELDS)}")
        super().__init__(**{**self.FIELDS, **set_fields})


def message_type(type_name: str, module: str = __name__, **fields: Any) -> type[Message]:
    """Return a message type with these fields and defaults. `module` must hold it under its own name."""
    return type(type_name.rpartition("/")[2], (Message,), {"__module__": module, "TYPE": type_name, "FIELDS": fields})


OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""Levels of a DiagnosticStatus."""
LOG_INFO, LOG_WARN, LOG_ERROR = 20, 30, 40
SPHERE, TEXT_VIEW_FACING = 2, 9
"""Types of a Marker."""
DELETEALL: Final = 3
"""An action of a Marker."""
_COVARIANCE: Final = (0.0,) * 9

Time: Final = message_type("builtin_interfaces/msg/Time", sec=0, nanosec=0)
String: Final = message_type("std_msgs/msg/String", data="")
Header: Final = message_type("std_msgs/msg/Header", stamp=Time(), frame_id="")
ColorRGBA: Final = message_type("std_msgs/msg/ColorRGBA", r=0.0, g=0.0, b=0.0, a=0.0)
MultiArrayDimension: Final = message_type("std_msgs/msg/MultiArrayDimension", label="", size=0, stride=0)
MultiArrayLayout: Final = message_type("std_msgs/msg/MultiArrayLayout", dim=())
Float64MultiArray: Final = message_type("std_msgs/msg/Float64MultiArray", layout=MultiArrayLayout(), data=())
Log: Final = message_type("rcl_interfaces/msg/Log", stamp=Time(), level=0, name="", msg="")

Point: Final = message_type("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)
Vector3: Final = message_type("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
Quaternion: Final = message_type("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
Pose: Final = message_type("geometry_msgs/msg/Pose", position=Point(), orientation=Quaternion())
Transform: Final = message_type("geometry_msgs/msg/Transform", translation=Vector3(), rotation=Quaternion())
_COVARIANCE_6: Final = (0.0,) * 36
PoseWithCovariance: Final = message_type("geometry_msgs/msg/PoseWithCovariance", pose=Pose(), covariance=_COVARIANCE_6)
Twist: Final = message_type("geometry_msgs/msg/Twist", linear=Vector3(), angular=Vector3())
TwistWithCovariance: Final = message_type(
    "geometry_msgs/msg/TwistWithCovariance", twist=Twist(), covariance=_COVARIANCE_6
)
Odometry: Final = message_type(
    "nav_msgs/msg/Odometry",
    header=Header(),
    child_frame_id="",
    pose=PoseWithCovariance(),
    twist=TwistWithCovariance(),
)
TransformStamped: Final = message_type(
    "geometry_msgs/msg/TransformStamped", header=Header(), child_frame_id="", transform=Transform()
)
TFMessage: Final = message_type("tf2_msgs/msg/TFMessage", transforms=())

JointState: Final = message_type("sensor_msgs/msg/JointState", header=Header(), name=(), position=())
Temperature: Final = message_type("sensor_msgs/msg/Temperature", header=Header(), temperature=0.0)
BatteryState: Final = message_type(
    "sensor_msgs/msg/BatteryState",
    header=Header(),
    voltage=0.0,
    temperature=0.0,
    current=0.0,
    charge=0.0,
    capacity=0.0,
    design_capacity=0.0,
    percentage=0.0,
    present=False,
)
Imu: Final = message_type(
    "sensor_msgs/msg/Imu",
    header=Header(),
    orientation=Quaternion(),
    orientation_covariance=_COVARIANCE,
    angular_velocity=Vector3(),
    angular_velocity_covariance=_COVARIANCE,
    linear_acceleration=Vector3(),
    linear_acceleration_covariance=_COVARIANCE,
)

KeyValue: Final = message_type("diagnostic_msgs/msg/KeyValue", key="", value="")
DiagnosticStatus: Final = message_type(
    "diagnostic_msgs/msg/DiagnosticStatus", level=0, name="", message="", hardware_id="", values=()
)
DiagnosticArray: Final = message_type("diagnostic_msgs/msg/DiagnosticArray", header=Header(), status=())

Marker: Final = message_type(
    "visualization_msgs/msg/Marker",
    header=Header(), ns="", id=0, type=0, action=0, pose=Pose(), scale=Vector3(), color=ColorRGBA(),
    frame_locked=False, text="",
)  # fmt: skip
MarkerArray: Final = message_type("visualization_msgs/msg/MarkerArray", markers=())
