"""Imports point from the outside in: which room may know which, read from the code."""

import ast
from pathlib import Path
from typing import Final

import pytest

GATEWAY = Path(__file__).parents[2] / "gateway"

ROOMS: Final = (
    ("errors", "limits"),
    ("protocol", "geometry"),
    ("core", "walking"),
    ("settings",),
    ("recordings",),
    ("host",),
    ("spi",),
    ("certs",),
    ("edge",),
    ("recorder",),
    ("runtime", "client"),
    ("service",),
    ("tools",),
    ("console",),
    ("cli",),
    ("__main__",),
)
"""From the inside out: a room knows itself and what stands before it, never its neighbour in the same row."""

PURE: Final = ("protocol", "core", "walking")
ALSO_PURE: Final = frozenset({"errors", "geometry"})
"""Geometry but for reading its file, which is for whoever calls."""
NOT_PURE: Final = frozenset(
    {"zenoh", "spidev", "asyncio", "time", "logging", "socket", "threading", "subprocess", "os"}
)
"""What reads a clock, does I/O, or waits: its time is an argument, its I/O somebody else's."""


def room_of(path: Path) -> str:
    """`gateway/core/legs.py` → `core`."""
    return path.relative_to(GATEWAY).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """The modules that a file imports, wherever in it that stands; `from a import b` as `a` and `a.b`."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


FILES = [path for path in sorted(GATEWAY.rglob("*.py")) if path.parent != GATEWAY or path.stem != "__init__"]
PLACE = {room: place for place, row in enumerate(ROOMS) for room in row}


def test_every_room_has_its_place() -> None:
    assert {room_of(path) for path in FILES} == PLACE.keys()


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(GATEWAY)))
def test_nothing_points_outward(path: Path) -> None:
    own = room_of(path)
    known = {name.split(".")[1] for name in imported(path) if name.startswith("gateway.")}
    for room in known & PLACE.keys():
        assert room == own or PLACE[room] < PLACE[own], f"{own} knows {room}"


@pytest.mark.parametrize("path", [path for path in FILES if room_of(path) in PURE], ids=lambda path: path.name)
def test_the_middle_is_pure(path: Path) -> None:
    names = imported(path)
    assert not {name.split(".")[0] for name in names} & NOT_PURE
    rooms = {name.split(".")[1] for name in names if name.startswith("gateway.")}
    assert rooms <= {*PURE, *ALSO_PURE}


def test_the_conductor_knows_no_zenoh() -> None:
    """So that a second edge could stand beside the first."""
    assert not {
        name for name in imported(GATEWAY / "runtime" / "conductor.py") if name.startswith(("zenoh", "gateway.edge"))
    }
