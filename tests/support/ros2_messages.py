"""`python -m tests.support.ros2_messages`: write gateway/people/ros2/messages.py from the store that `rosbags` keeps.

A type must be the same in all distributions. rosbags has no services: Trigger is built here as REP-2016 has it.
"""

import sys
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

FILE: Final = Path(__file__).parents[2] / "gateway/people/ros2/messages.py"

DISTRIBUTIONS: Final = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
    "lyrical": Stores.ROS2_LYRICAL,
}
TRIGGER: Final = "std_srvs/srv/Trigger"
WANTED: Final = (
    "std_msgs/msg/String",
    "std_msgs/msg/Int32",
    "std_msgs/msg/Float64",
    "sensor_msgs/msg/JointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "tf2_msgs/msg/TFMessage",
    "trajectory_msgs/msg/JointTrajectory",
    "rcl_interfaces/msg/Log",
    "visualization_msgs/msg/MarkerArray",
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/Temperature",
    f"{TRIGGER}_Request",
    f"{TRIGGER}_Response",
)
OTHERWISE: Final = {"Imu": "ImuMessage"}
"""Names of classes, where the schemas have one of ROS 2's name."""
PYTHON: Final = {
    "bool": ("bool", "False"),
    "byte": ("byte", "0"),
    "uint8": ("uint8", "0"),
    "int32": ("int32", "0"),
    "uint32": ("uint32", "0"),
    "float32": ("float32", "0.0"),
    "float64": ("float64", "0.0"),
    "string": ("str", '""'),
}
_HEAD: Final = '''"""ROS 2's message types, written by `python -m tests.support.ros2_messages`: do not edit.

They are the same in all of `DISTRIBUTIONS` (rosbags keeps their definitions). Fields are documented where ROS 2 is.
"""

from typing import Annotated, ClassVar, Final

from gateway.people.ros2.cdr import Message, byte, float32, float64, int32, ros_msg, uint8, uint32

DISTRIBUTIONS: Final = ({distributions})

TRIGGER_TYPE: Final = "{trigger}"
TRIGGER_HASH: Final = "{trigger_hash}"
"""Of the service; its request and response have hashes of their own, which nothing on the wire shows."""
'''


def store_of(distribution: str) -> Typestore:
    """The types of one distribution, and Trigger."""
    store = get_typestore(DISTRIBUTIONS[distribution])
    # rosbags hashes a `char` as a type of its own; in REP-2016 it is a uint8.
    store.fielddefs |= {
        f"{TRIGGER}_Request": ([], []),
        f"{TRIGGER}_Response": ([], [("success", _plain("bool")), ("message", _plain("string"))]),
        "service_msgs/msg/ServiceEventInfo": (
            [],
            [
                ("event_type", _plain("uint8")),
                ("stamp", _nested("builtin_interfaces/msg/Time")),
                ("client_gid", (Nodetype.ARRAY, (_plain("uint8"), 16))),
                ("sequence_number", _plain("int64")),
            ],
        ),
        f"{TRIGGER}_Event": (
            [],
            [
                ("info", _nested("service_msgs/msg/ServiceEventInfo")),
                ("request", (Nodetype.SEQUENCE, (_nested(f"{TRIGGER}_Request"), 1))),
                ("response", (Nodetype.SEQUENCE, (_nested(f"{TRIGGER}_Response"), 1))),
            ],
        ),
        TRIGGER: (
            [],
            [
                ("request_message", _nested(f"{TRIGGER}_Request")),
                ("response_message", _nested(f"{TRIGGER}_Response")),
                ("event_message", _nested(f"{TRIGGER}_Event")),
            ],
        ),
    }
    return store


def _plain(name: str) -> Any:
    return Nodetype.BASE, (name, 0)


def _nested(name: str) -> Any:
    return Nodetype.NAME, name


def text() -> str:
    """What the module is to have. Raises ValueError where a type differs between distributions."""
    stores = [store_of(name) for name in DISTRIBUTIONS]
    newest = stores[-1]
    needed: dict[str, None] = {}
    for name in WANTED:
        _need(newest, name, needed)
    for name in (*needed, TRIGGER):
        if len({store.hash_rihs01(name) for store in stores}) != 1:
            raise ValueError(f"{name} is not the same in {', '.join(DISTRIBUTIONS)}")
    head = _HEAD.format(
        distributions=", ".join(f'"{name}"' for name in DISTRIBUTIONS),
        trigger=TRIGGER,
        trigger_hash=newest.hash_rihs01(TRIGGER),
    )
    return head + "".join(_class(newest, name) for name in needed)


def _need(store: Typestore, name: str, needed: dict[str, None]) -> None:
    """The types inside of it first."""
    for _, description in store.fielddefs[name][1]:
        element, *_ = _element(description)
        if "/" in element:
            _need(store, element, needed)
    needed[name] = None


def _element(description: Any) -> tuple[str, bool, int]:
    """The element, whether there are many of it, and how many an array has."""
    node, what = description
    if node == Nodetype.BASE and what[1] == 0:
        return str(what[0]), False, 0
    if node == Nodetype.NAME:
        return str(what), False, 0
    if node == Nodetype.SEQUENCE and what[1] == 0:
        return _element(what[0])[0], True, 0
    if node == Nodetype.ARRAY and what[0] == _plain("float64"):
        return "float64", True, what[1]
    raise ValueError(f"cdr.py has no such arrays and no bounds: {description}")


def _class(store: Typestore, name: str) -> str:
    constants, fields = store.fielddefs[name]
    lines = [
        "",
        "",
        f'@ros_msg("{name}", "{store.hash_rihs01(name).removeprefix("RIHS01_")}")',
        f"class {_python(name)}(Message):",
        *(f"    {constant}: ClassVar[{type_name}] = {value}" for constant, type_name, value in constants),
    ]
    if constants:
        lines.append("")
    if not fields:
        lines.append('    """It has no fields."""')
    lines += [_attribute(field, description) for field, description in fields]
    return "\n".join(lines) + "\n"


def _attribute(name: str, description: Any) -> str:
    element, many, count = _element(description)
    kind, default = (_python(element), f"{_python(element)}()") if "/" in element else PYTHON[element]
    if count:
        return f"    {name}: Annotated[tuple[{kind}, ...], {count}] = ({default},) * {count}"
    if many:
        return f"    {name}: tuple[{kind}, ...] = ()"
    return f"    {name}: {kind} = {default}"


def _python(name: str) -> str:
    """`std_msgs/msg/String` → `String`, `std_srvs/srv/Trigger_Request` → `TriggerRequest`."""
    short = name.rsplit("/", maxsplit=1)[1].replace("_", "")
    return OTHERWISE.get(short, short)


if __name__ == "__main__":
    FILE.write_text(text())
    sys.stdout.write(f"{FILE} is written\n")
