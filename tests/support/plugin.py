"""A plug-in as somebody else would install it: a wire that writes to a file, and a folder to search for it."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

NAME: Final = "to-file"
WIRE: Final = """
import os
import time

from gateway.wire import ServoWire


class ToFile(ServoWire):
    def __init__(self, options):
        if "path" not in options:
            raise ValueError("path is missing: the file to write to")
        self._path = options["path"]

    def open(self):
        if os.path.exists(self._path + ".unplugged"):
            raise OSError(6, "no such device")
        self._file = open(self._path, "a")

    def apply(self, changes):
        if os.path.exists(self._path + ".unplugged"):
            raise OSError(5, "it does not answer")
        if os.path.exists(self._path + ".mistake"):
            raise RuntimeError("a mistake in the plug-in")
        while os.path.exists(self._path + ".hangs"):
            open(self._path + ".hung", "w").close()
            time.sleep(0.01)
        self._file.write(f"{time.monotonic_ns()} {os.getpid()} {list(changes)}\\n")
        self._file.flush()

    def close(self):
        self._file.close()
"""


class Call(NamedTuple):
    """One call of `apply`."""

    monotonic_ns: int
    process: int
    changes: dict[int, float | None]

    @property
    def stops(self) -> bool:
        """Whether all are Stops."""
        return set(self.changes.values()) == {None}


class Installed:
    """The plug-in, installed in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.path = folder / "written"
        names = ("unplugged", "mistake", "hangs", "hung")
        self.unplugged, self.mistake, self.hangs, self.hung = (folder / f"written.{name}" for name in names)
        (folder / "to_file.py").write_text(WIRE)
        described = folder / "to_file-1.0.dist-info"  # as if pip had installed it
        described.mkdir()
        (described / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {NAME}\nVersion: 1.0\n")
        (described / "entry_points.txt").write_text(f"[hexapod_gateway.wires]\n{NAME} = to_file:ToFile\n")

    @property
    def section(self) -> dict[str, Any]:
        """[wire] of gateway.toml."""
        return {"name": NAME, "path": str(self.path)}

    @property
    def env(self) -> Mapping[str, str]:
        """The variables of a program that finds it."""
        return {**os.environ, "PYTHONPATH": str(self._folder)}

    def calls(self, since: int = 0) -> list[Call]:
        """What it was called with, from the first or that one on."""
        lines = self.path.read_text().splitlines() if self.path.exists() else []
        found = (line.split(" ", 2) for line in lines[since:])
        return [Call(int(ns), int(process), dict(_changes(text))) for ns, process, text in found]


def _changes(text: str) -> list[tuple[int, float | None]]:
    pairs = (each.split(", ") for each in text[2:-2].split("), ("))
    return [(int(servo), None if angle == "None" else float(angle)) for servo, angle in pairs]
