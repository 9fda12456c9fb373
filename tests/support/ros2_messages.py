"""ROS 2's messages that tests send and the bridge takes; and any message, from rclpy's, or from bytes by rosbags."""

import dataclasses
from types import SimpleNamespace
from typing import Any, Final

from rosbags.typesys import Stores, get_typestore

from gateway.people.ros2.messages import Header, Message, Time, Twist, message_type


def _type(type_name: str, **defaults: Any) -> type[Message]:
    """Return a type whose messages have all these fields, as those that rclpy hands to the bridge."""
    made = message_type(type_name, " ".join(defaults), __name__)
    for name, value in defaults.items():
        setattr(made, name, value)
    return made


Int32: Final = _type("std_msgs/msg/Int32", data=0)
Float64: Final = _type("std_msgs/msg/Float64", data=0.0)
TwistStamped: Final = _type("geometry_msgs/msg/TwistStamped", header=Header(Time(0, 0), ""), twist=Twist())
Duration: Final = _type("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
STORE: Final = get_typestore(Stores.ROS2_JAZZY)


def replace(message: Message, **fields: Any) -> Any:
    """Return the message, with other values in these fields."""
    return type(message)(**vars(message) | fields)


def plain(found: Any) -> Any:
    """Return rclpy's message, or rosbags', as values that can be pickled: all its fields; sequences are tuples."""
    if hasattr(found, "get_fields_and_field_types"):
        names = list(found.get_fields_and_field_types())
    elif dataclasses.is_dataclass(found):
        names = [each.name for each in dataclasses.fields(found) if each.name != "__msgtype__"]
    elif isinstance(found, bytes):  # a `byte`
        return found[0]
    else:
        values = found.tolist() if hasattr(found, "tolist") else found
        return tuple(map(plain, values)) if isinstance(values, list | tuple) else values
    return SimpleNamespace(**{name: plain(getattr(found, name)) for name in names})


def decode(kind: type[Message], data: bytes) -> Any:
    """Return a message's bytes, as rosbags reads them."""
    return plain(STORE.deserialize_cdr(data, kind.TYPE))
