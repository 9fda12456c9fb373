"""The client's modules stand in a line: none imports, also for a type, one that imports it."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Final

import gateway.people.client

ROOM: Final = "gateway.people.client"


def imports(source: str) -> set[str]:
    """The room's modules that a module imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
    return {name.removeprefix(f"{ROOM}.") for name in found if name.startswith(f"{ROOM}.")}


def test_no_imports_in_a_circle() -> None:
    files = {path.stem: path for path in Path(gateway.people.client.__path__[0]).glob("*.py")}
    graph = {name: imports(path.read_text()) & files.keys() for name, path in files.items()}
    assert graph["aio"] > {"blocking", "walk"}  # it does find them
    TopologicalSorter(graph).prepare()  # raises CycleError, with the circle
