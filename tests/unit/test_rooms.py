"""Imports point from the outside in: which room may know which, read from the code."""

import ast
import re
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Final

from gateway.model.protocols import SpiProtocol

GATEWAY = Path(__file__).parents[2] / "gateway"

ROOMS: Final = (
    ("words",),
    ("errors", "files", "rate_limit", "wire", "zenoh.endpoints", "zenoh.limits"),
    ("model", "geometry"),
    ("host", "certs"),
    ("zenoh.config",),
    ("people.numbers",),
    ("robot.core", "people.walking"),
    ("robot.settings", "robot.protocol", "people.physics"),
    ("robot.host", "people.client"),
    ("robot.spi", "client", "people.terminal", "people.watching"),
    ("robot.zenoh_io", "robot.power", "people.commands", "simulation"),
    ("robot.blackbox", "people.console", "people.ros2"),
    ("robot.runtime", "robot.wires", "people.recorder"),
    ("people.incidents",),
    ("robot.service",),
    ("onboard",),
    ("cli",),
    ("__main__",),
)
"""From the inside out: a room knows itself and what stands before it, never its neighbour in the same row."""

WINGS: Final = ("robot", "people")
SHARED: Final = frozenset(room for row in ROOMS[:5] for room in row)
"""What both wings mean by the same words, and do in the same way."""
KNOW_BOTH: Final = frozenset({"onboard", "cli", "__main__"})
PURE: Final = ("model", "robot.core", "robot.protocol", "people.walking")
PURE_FILES: Final = frozenset(
    f"{name}.py"
    for name in (
        "robot/power/board", "robot/power/questions", "simulation/board", "people/ros2/commanded", "people/ros2/joints",
        "people/ros2/messages", "people/ros2/parameters", "people/ros2/robot",
    )
)  # fmt: skip
"""In rooms that also do I/O."""
ALSO_PURE: Final = frozenset({"errors", "geometry", "rate_limit", "wire", "words", *WINGS})
"""Geometry but for reading its file, which is for whoever calls."""
NOT_PURE: Final = frozenset(
    {"zenoh", "spidev", "asyncio", "time", "logging", "socket", "threading", "subprocess", "os"}
)
"""What reads a clock, does I/O, or waits: its time is an argument, its I/O somebody else's."""


def room_of(name: str) -> str:
    """Return a name's room: `gateway.robot.core.legs` → `robot.core`, `gateway.errors.GatewayError` → `errors`."""
    parts = name.split(".")[1:]
    return ".".join(parts[: 2 if parts[0] in (*WINGS, "zenoh") else 1])


def wing_of(room: str) -> str:
    """Return `robot`, `people` (`gateway.client` is its face), or a room that is in neither."""
    return {"client": "people", "simulation": "robot"}.get(room, room.partition(".")[0])


def room_of_file(path: Path) -> str:
    """Return a file's room: `gateway/robot/core/legs.py` → `robot.core`."""
    return room_of(".".join(("gateway", *path.relative_to(GATEWAY).with_suffix("").parts)))


@cache
def imported(path: Path) -> frozenset[str]:
    """Return the modules that a file imports, wherever in it that stands; `from a import b` as `a` and `a.b`."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


FILES = [
    path
    for path in sorted(GATEWAY.rglob("*.py"))
    if path.stem != "__init__" or path.parent not in (GATEWAY, *(GATEWAY / folder for folder in (*WINGS, "zenoh")))
]
PLACE = {room: place for place, row in enumerate(ROOMS) for room in row}


def test_every_room_has_its_place() -> None:
    assert {room_of_file(path) for path in FILES} == PLACE.keys()


def test_nothing_points_outward_and_no_wing_knows_the_other() -> None:
    """So that each wing can change alone, and who reviews what keeps the robot safe reads nothing of the other.

    Whatever belongs to no wing is shared, and knows neither; only commands that run on the robot know both.
    """
    for path in FILES:
        own = room_of_file(path)
        known = {room_of(name) for name in imported(path) if name.startswith("gateway.")} & PLACE.keys()
        for room in known - {own}:
            assert PLACE[room] < PLACE[own], f"{path}: {own} knows {room}"
            assert own in KNOW_BOTH or room in SHARED or wing_of(room) == wing_of(own), f"{path}: {own} knows {room}"


def test_no_files_import_each_other_in_a_circle() -> None:
    """Nor for types alone: of two such files neither can be read, tested or replaced without the other.

    A package's face (`certs/__init__.py`) is left out, as it names the package's own files.
    """
    modules = {".".join(("gateway", *path.relative_to(GATEWAY).with_suffix("").parts)): path for path in FILES}
    graph = {name: imported(path) & modules.keys() - {name} for name, path in modules.items()}
    assert tuple(TopologicalSorter(graph).static_order())  # raises CycleError, which names the files


def test_the_middle_is_pure() -> None:
    for path in FILES:
        if room_of_file(path) not in PURE and str(path.relative_to(GATEWAY)) not in PURE_FILES:
            continue
        names = imported(path)
        assert not {name.split(".")[0] for name in names} & NOT_PURE, path
        assert {room_of(name) for name in names if name.startswith("gateway.")} <= {
            *PURE,
            *ALSO_PURE,
            "robot.power",
            "people.ros2",
            "people.numbers",
        }, path
        assert not names & {"gateway.robot.power.line", "gateway.robot.power.slcan", "can"}, path


def test_only_the_robots_wing_and_its_commands_know_the_settings() -> None:
    settings = {"gateway.robot.settings", "gateway.host.settings_table"}
    knowing = {room_of_file(path) for path in FILES if settings & imported(path)}
    assert {room for room in knowing if not room.startswith("robot.")} == {"host", "onboard"}


def test_each_class_has_a_name_of_its_own() -> None:
    """A name means one thing in the gateway and the schemas."""
    places = [*GATEWAY.rglob("*.py"), *(GATEWAY.parent / "schemas").rglob("*.py")]
    names = Counter(name for path in places for name in re.findall(r"^ *class (\w+)", path.read_text(), re.MULTILINE))
    assert [name for name, count in names.items() if count > 1] == []


def test_the_conductor_knows_no_zenoh() -> None:
    """So that another transport could stand in its place."""
    assert not {
        name
        for name in imported(GATEWAY / "robot/runtime/conductor.py")
        if name.startswith(("zenoh", "gateway.robot.zenoh_io"))
    }


WIRES_OWN: Final = frozenset(
    {
        *("model/protocols.py", "model/elkapod.py", "robot/protocol/elkapod.py"),
        *(f"robot/spi/{name}.py" for name in ("cyclic", "uart")),
        *("host/settings_table.py", "simulation/elkapod.py"),
    }
)
"""The wires themselves, what makes them, and the table of settings."""


def test_no_wire_is_named_outside_its_own_files() -> None:
    """What depends on a wire is one of its capabilities."""
    names = (*SpiProtocol, *SpiProtocol.__members__, "SpiProtocol.")
    files = [path for kind in ("*.py", "*.js", "*.html") for path in GATEWAY.rglob(kind) if "vendor" not in path.parts]
    files += (GATEWAY.parent / "schemas").glob("*.py")
    named = [path for path in files if any(name in path.read_text() for name in names)]
    assert {str(path).removeprefix(f"{GATEWAY}/") for path in named} == WIRES_OWN
