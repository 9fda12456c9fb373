"""Imports point from the outside in: which room may know which, read from the code."""

import ast
from pathlib import Path
from typing import Final

import pytest

GATEWAY = Path(__file__).parents[2] / "gateway"

ROOMS: Final = (
    ("allowance", "durable", "errors", "limits", "nesting", "text", "web_hosts"),
    ("robot.protocol", "geometry"),
    ("robot.core", "people.walking", "people.ros2"),
    ("robot.settings",),
    ("robot.host",),
    ("robot.spi",),
    ("certs",),
    ("zenoh_config",),
    ("robot.edge",),
    ("robot.blackbox",),
    ("robot.runtime",),
    ("robot.service",),
    ("people.recordings", "people.physics", "people.terminal"),
    ("people.incidents",),
    ("people.client",),
    ("client",),
    ("people.tools",),
    ("people.console", "people.bridge"),
    ("cli",),
    ("__main__",),
)
"""From the inside out: a room knows itself and what stands before it, never its neighbour in the same row."""

WINGS: Final = ("robot", "people")
PURE: Final = ("robot.protocol", "robot.core", "people.walking", "people.ros2")
ALSO_PURE: Final = frozenset({"allowance", "errors", "geometry", "text", *WINGS})
"""Geometry but for reading its file, which is for whoever calls."""
NOT_PURE: Final = frozenset(
    {"zenoh", "spidev", "asyncio", "time", "logging", "socket", "threading", "subprocess", "os"}
)
"""What reads a clock, does I/O, or waits: its time is an argument, its I/O somebody else's."""


def room_of(name: str) -> str:
    """`gateway.robot.core.legs` → `robot.core`, `gateway.errors.GatewayError` → `errors`."""
    parts = name.split(".")[1:]
    return ".".join(parts[: 2 if parts[0] in WINGS else 1])


def room_of_file(path: Path) -> str:
    """`gateway/robot/core/legs.py` → `robot.core`."""
    return room_of(".".join(("gateway", *path.relative_to(GATEWAY).with_suffix("").parts)))


def imported(path: Path) -> set[str]:
    """The modules that a file imports, wherever in it that stands; `from a import b` as `a` and `a.b`."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


FILES = [
    path
    for path in sorted(GATEWAY.rglob("*.py"))
    if path.stem != "__init__" or path.parent not in (GATEWAY, *(GATEWAY / wing for wing in WINGS))
]
PLACE = {room: place for place, row in enumerate(ROOMS) for room in row}


def test_every_room_has_its_place() -> None:
    assert {room_of_file(path) for path in FILES} == PLACE.keys()


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(GATEWAY)))
def test_nothing_points_outward(path: Path) -> None:
    own = room_of_file(path)
    known = {room_of(name) for name in imported(path) if name.startswith("gateway.")}
    for room in known & PLACE.keys():
        assert room == own or PLACE[room] < PLACE[own], f"{own} knows {room}"


@pytest.mark.parametrize("path", [path for path in FILES if room_of_file(path) in PURE], ids=lambda path: path.name)
def test_the_middle_is_pure(path: Path) -> None:
    names = imported(path)
    assert not {name.split(".")[0] for name in names} & NOT_PURE
    assert {room_of(name) for name in names if name.startswith("gateway.")} <= {*PURE, *ALSO_PURE}


@pytest.mark.parametrize("path", sorted((GATEWAY / "robot").rglob("*.py")), ids=lambda path: path.name)
def test_the_robots_wing_knows_nothing_of_the_peoples(path: Path) -> None:
    """So that a reviewer of what keeps the robot safe reads no line of what is comfortable."""
    assert not {name for name in imported(path) if name.startswith(("gateway.people", "gateway.client", "gateway.cli"))}


def test_the_conductor_knows_no_zenoh() -> None:
    """So that a second edge could stand beside the first."""
    assert not {
        name
        for name in imported(GATEWAY / "robot/runtime/conductor.py")
        if name.startswith(("zenoh", "gateway.robot.zenoh_io"))
    }
