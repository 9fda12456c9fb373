"""`python -m tests.support.ros2_messages`: write messages.py and actions.py in gateway/people/ros2 from rosbags' store.

A type must be the same in all distributions. rosbags has no services, no actions and no control_msgs: they are built
here as REP-2016 has them, FollowJointTrajectory as control_msgs 4 and 5 (Humble, Jazzy) and 6 up to 6.2 define it.
"""

import sys
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

FOLDER: Final = Path(__file__).parents[2] / "gateway/people/ros2"

DISTRIBUTIONS: Final = {
    "humble": Stores.ROS2_HUMBLE,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
    "lyrical": Stores.ROS2_LYRICAL,
}
TRIGGER: Final = "std_srvs/srv/Trigger"
CANCEL: Final = "action_msgs/srv/CancelGoal"
FOLLOW: Final = "control_msgs/action/FollowJointTrajectory"
SERVICES: Final = {"SEND_GOAL": f"{FOLLOW}_SendGoal", "GET_RESULT": f"{FOLLOW}_GetResult", "CANCEL_GOAL": CANCEL}
"""Of the action."""
WANTED: Final = (
    "std_msgs/msg/String",
    "std_msgs/msg/Int32",
    "std_msgs/msg/Float64",
    "std_msgs/msg/Float64MultiArray",
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
WANTED_OF_ACTIONS: Final = (
    *(f"{service}_{part}" for service in SERVICES.values() for part in ("Request", "Response")),
    "action_msgs/msg/GoalStatusArray",
    f"{FOLLOW}_FeedbackMessage",
)
_TOLERANCE: Final = "float64 position\nfloat64 velocity\nfloat64 acceleration"
ADDED: Final = {
    f"{TRIGGER}_Request": "",
    f"{TRIGGER}_Response": "bool success\nstring message",
    f"{CANCEL}_Request": "action_msgs/msg/GoalInfo goal_info",
    f"{CANCEL}_Response": """
        int8 ERROR_NONE=0
        int8 ERROR_REJECTED=1
        int8 ERROR_UNKNOWN_GOAL_ID=2
        int8 ERROR_GOAL_TERMINATED=3
        int8 return_code
        action_msgs/msg/GoalInfo[] goals_canceling""",
    "control_msgs/msg/JointTolerance": f"string name\n{_TOLERANCE}",
    "control_msgs/msg/JointComponentTolerance": f"""
        string joint_name
        uint16 component
        {_TOLERANCE}""",
    f"{FOLLOW}_Goal": """
        trajectory_msgs/msg/JointTrajectory trajectory
        trajectory_msgs/msg/MultiDOFJointTrajectory multi_dof_trajectory
        control_msgs/msg/JointTolerance[] path_tolerance
        control_msgs/msg/JointComponentTolerance[] component_path_tolerance
        control_msgs/msg/JointTolerance[] goal_tolerance
        control_msgs/msg/JointComponentTolerance[] component_goal_tolerance
        builtin_interfaces/msg/Duration goal_time_tolerance""",
    f"{FOLLOW}_Result": """
        int32 SUCCESSFUL=0
        int32 INVALID_GOAL=-1
        int32 INVALID_JOINTS=-2
        int32 OLD_HEADER_TIMESTAMP=-3
        int32 PATH_TOLERANCE_VIOLATED=-4
        int32 GOAL_TOLERANCE_VIOLATED=-5
        int32 error_code
        string error_string""",
    f"{FOLLOW}_Feedback": """
        std_msgs/msg/Header header
        string[] joint_names
        trajectory_msgs/msg/JointTrajectoryPoint desired
        trajectory_msgs/msg/JointTrajectoryPoint actual
        trajectory_msgs/msg/JointTrajectoryPoint error
        string[] multi_dof_joint_names
        trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_desired
        trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_actual
        trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_error""",
    f"{FOLLOW}_SendGoal_Request": f"unique_identifier_msgs/msg/UUID goal_id\n{FOLLOW}_Goal goal",
    f"{FOLLOW}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/msg/Time stamp",
    f"{FOLLOW}_GetResult_Request": "unique_identifier_msgs/msg/UUID goal_id",
    f"{FOLLOW}_GetResult_Response": f"int8 status\n{FOLLOW}_Result result",
    f"{FOLLOW}_FeedbackMessage": f"unique_identifier_msgs/msg/UUID goal_id\n{FOLLOW}_Feedback feedback",
}
"""What rosbags has not, by its fields."""
OTHERWISE: Final = {"Imu": "ImuMessage"}
"""Names of classes, where the schemas have one of ROS 2's name."""
PYTHON: Final = {
    "bool": ("bool", "False"),
    "byte": ("byte", "0"),
    "int8": ("int8", "0"),
    "uint8": ("uint8", "0"),
    "uint16": ("uint16", "0"),
    "int32": ("int32", "0"),
    "uint32": ("uint32", "0"),
    "float32": ("float32", "0.0"),
    "float64": ("float64", "0.0"),
    "string": ("str", '""'),
}
_MESSAGES: Final = '''"""ROS 2's message types, written by `python -m tests.support.ros2_messages`: do not edit.

They are the same in all of `DISTRIBUTIONS` (rosbags keeps their definitions). Fields are documented where ROS 2 is.
"""

from typing import Annotated, ClassVar, Final

from gateway.people.ros2.cdr import Message, byte, float32, float64, int32, ros_msg, uint8, uint32

DISTRIBUTIONS: Final = ({distributions})

TRIGGER_TYPE: Final = "{trigger}"
TRIGGER_HASH: Final = "{trigger_hash}"
"""Of the service; its request and response have hashes of their own, which nothing on the wire shows."""
'''
_ACTIONS: Final = '''\
"""What the action FollowJointTrajectory sends, written by `python -m tests.support.ros2_messages`: do not edit.

As control_msgs 4 and 5 (Humble, Jazzy) and 6 up to 6.2 define it; since 6.3 its feedback has another field.
"""

from typing import Annotated, ClassVar, Final

from gateway.people.ros2.cdr import Message, float64, int8, int32, ros_msg, uint8, uint16
from gateway.people.ros2.messages import (
{imported}
)

{services}
"""Type and hash of each service."""
'''


def store_of(distribution: str) -> Typestore:
    """The types of one distribution, and what is added."""
    store = get_typestore(DISTRIBUTIONS[distribution])
    # rosbags hashes a `char` as a type of its own; in REP-2016 it is a uint8.
    for name, fields in ADDED.items():
        if fields and name not in store.types:
            ((_, found),) = get_types_from_msg(fields, name.replace("/srv/", "/msg/")).items()
            store.register({name: found})
    store.fielddefs |= {
        f"{TRIGGER}_Request": ([], []),
        "service_msgs/msg/ServiceEventInfo": (
            [],
            [
                ("event_type", _plain("uint8")),
                ("stamp", _nested("builtin_interfaces/msg/Time")),
                ("client_gid", (Nodetype.ARRAY, (_plain("uint8"), 16))),
                ("sequence_number", _plain("int64")),
            ],
        ),
    }
    for service in (TRIGGER, *SERVICES.values()):
        store.fielddefs |= _service(service)
    return store


def _service(name: str) -> dict[str, Any]:
    """What REP-2016 makes of a service's request and response."""
    return {
        f"{name}_Event": (
            [],
            [
                ("info", _nested("service_msgs/msg/ServiceEventInfo")),
                ("request", (Nodetype.SEQUENCE, (_nested(f"{name}_Request"), 1))),
                ("response", (Nodetype.SEQUENCE, (_nested(f"{name}_Response"), 1))),
            ],
        ),
        name: (
            [],
            [(f"{part}_message", _nested(f"{name}_{part.title()}")) for part in ("request", "response", "event")],
        ),
    }


def _plain(name: str) -> Any:
    return Nodetype.BASE, (name, 0)


def _nested(name: str) -> Any:
    return Nodetype.NAME, name


def texts() -> dict[Path, str]:
    """What each module is to have. Raises ValueError where a type differs between distributions."""
    stores = [store_of(name) for name in DISTRIBUTIONS]
    newest = stores[-1]
    messages = _needed(newest, WANTED)
    actions = [name for name in _needed(newest, WANTED_OF_ACTIONS) if name not in messages]
    for name in (*messages, *actions, TRIGGER, *SERVICES.values()):
        if len({store.hash_rihs01(name) for store in stores}) != 1:
            raise ValueError(f"{name} is not the same in {', '.join(DISTRIBUTIONS)}")
    head = _MESSAGES.format(
        distributions=", ".join(f'"{name}"' for name in DISTRIBUTIONS),
        trigger=TRIGGER,
        trigger_hash=newest.hash_rihs01(TRIGGER),
    )
    inner = {element for name in actions for _, each in newest.fielddefs[name][1] for element, *_ in [_element(each)]}
    services = [
        _wrapped(f"{name}: Final = (", f'"{service}"', f'"{newest.hash_rihs01(service)}"', ")")
        for name, service in SERVICES.items()
    ]
    head_of_actions = _ACTIONS.format(
        imported="\n".join(f"    {name}," for name in sorted(map(_python, inner & messages.keys()))),
        services="\n".join(services),
    )
    return {
        FOLDER / "messages.py": head + "".join(_class(newest, name) for name in messages),
        FOLDER / "actions.py": head_of_actions + "".join(_class(newest, name) for name in actions),
    }


def _wrapped(begin: str, first: str, second: str, end: str) -> str:
    line = f"{begin}{first}, {second}{end}"
    return line if len(line) <= 120 else f"{begin}\n    {first},\n    {second},\n{end}"


def _needed(store: Typestore, wanted: tuple[str, ...]) -> dict[str, None]:
    needed: dict[str, None] = {}
    for name in wanted:
        _need(store, name, needed)
    return needed


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
    if node == Nodetype.ARRAY and what[0] in (_plain("float64"), _plain("uint8")):
        return _element(what[0])[0], True, what[1]
    raise ValueError(f"cdr.py has no such arrays and no bounds: {description}")


def _class(store: Typestore, name: str) -> str:
    constants, fields = store.fielddefs[name]
    lines = [
        "",
        "",
        _wrapped("@ros_msg(", f'"{name}"', f'"{store.hash_rihs01(name).removeprefix("RIHS01_")}"', ")"),
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
    return OTHERWISE.get(short, short.replace("FollowJointTrajectory", "Follow"))


if __name__ == "__main__":
    for path, written in texts().items():
        path.write_text(written)
        sys.stdout.write(f"{path} is written\n")
