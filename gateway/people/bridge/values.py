"""rclpy's messages from ours, and back: field by field, by the names of ROS 2."""

from importlib import import_module
from typing import Any

from gateway.errors import ConfigError
from gateway.people.ros2.messages import M, Message


def ros_type(type_name: str) -> Any:
    """`std_msgs/msg/String` → rclpy's class. Raises ConfigError if its package is not installed."""
    package, kind, name = type_name.split("/")
    action, _, part = name.partition("_")
    try:
        found = getattr(import_module(f"{package}.{kind}"), action)
    except ImportError as error:
        raise ConfigError(f"this ROS 2 has no {package}: {error}") from error
    return getattr(found, part) if part else found


def to_ros(message: Message) -> Any:
    """rclpy's message with these fields; the others have their defaults. Raises AssertionError as rclpy does."""
    made = ros_type(message.TYPE)()
    for name, inner, many in message.FIELDS:
        value: Any = getattr(message, name)
        if inner is not None:
            value = [to_ros(each) for each in value] if many else to_ros(value)
        elif isinstance(getattr(made, name), bytes):  # a `byte`
            value = bytes((value,))
        setattr(made, name, value)
    return made


def from_ros(kind: type[M], found: Any) -> M:
    """Our message with what this one of rclpy has in the same fields."""
    fields = {}
    for name, inner, many in kind.FIELDS:
        value = getattr(found, name)
        if inner is not None:
            value = tuple(from_ros(inner, each) for each in value) if many else from_ros(inner, value)
        elif many:
            value = tuple(value.tolist() if hasattr(value, "tolist") else value)
        elif isinstance(value, bytes):
            value = value[0]
        fields[name] = value
    return kind(**fields)
