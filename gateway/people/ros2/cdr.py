"""ROS 2's messages as bytes (CDR), and their types as text (`ros2msg`), by `rosbags`: what a recording holds."""

from importlib.util import find_spec
from typing import Any, Final

from gateway.people.ros2.messages import Message

INSTALLED: Final = find_spec("rosbags") is not None
"""A robot has no rosbags: it needs NumPy and a dozen more. There incidents are kept without ROS 2's messages."""
if INSTALLED:
    import numpy as np
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import Stores, get_typestore

    _STORE: Final = get_typestore(Stores.ROS2_JAZZY)
    """The types used here are the same in Humble, Jazzy, Kilted and Lyrical."""


def encode(message: Message) -> bytes:
    """Return the message's bytes, with the encapsulation. Raises ValueError if a value does not fit its field."""
    try:
        return bytes(_STORE.serialize_cdr(_made(message.TYPE, message), message.TYPE))
    except Exception as error:  # rosbags' own, struct's, numpy's
        raise ValueError(f"{message.TYPE} cannot be written: {error}") from error


def definition(kind: type[Message]) -> str:
    """Return the type's fields as text, and those of every type inside it: any program can read a message by it."""
    return _STORE.generate_msgdef(kind.TYPE, ros_version=2)[0]


def _made(type_name: str, message: Message | None) -> Any:
    """rosbags' own message with these fields; the others have ROS 2's defaults."""
    _, fields = _STORE.fielddefs[type_name]
    return _STORE.types[type_name](**{name: _value(kind, getattr(message, name, None)) for name, kind in fields})


def _value(kind: Any, value: Any) -> Any:
    node, what = kind
    if node == Nodetype.NAME:
        return _made(what, value)
    if node == Nodetype.BASE:
        return value if value is not None else "" if what[0] == "string" else False if what[0] == "bool" else 0
    (inner, element), count = what
    if inner == Nodetype.BASE and element[0] != "string":
        return np.array(value if value is not None else (0,) * count, dtype=element[0])
    return [_value((inner, element), each) for each in value or ()]
