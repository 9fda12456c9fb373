"""ROS 2's messages from bytes, by rosbags."""

from typing import Any, Final

from rosbags.typesys import Stores, get_typestore

from gateway.people.bridge.values import from_ros
from gateway.people.ros2.messages import M

STORES: Final = {
    name: get_typestore(store)
    for name, store in (
        ("humble", Stores.ROS2_HUMBLE),
        ("jazzy", Stores.ROS2_JAZZY),
        ("kilted", Stores.ROS2_KILTED),
        ("lyrical", Stores.ROS2_LYRICAL),
    )
}
STORE: Final = STORES["jazzy"]


def decode(kind: type[M], data: bytes) -> M:
    found: Any = STORE.deserialize_cdr(data, kind.TYPE)
    return from_ros(kind, found)
