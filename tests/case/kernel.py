"""What `make kernel` has left: scenes on a real kernel's spidev, with their date."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from tests.case.case import ROOT

REPORT: Final = ROOT / "safety" / "kernel.json"
"""Committed, since it needs a virtual machine; and not below `tests`, so that it does not change the files' mark."""


@dataclass(frozen=True)
class Report:
    """One run of all scenes."""

    date: str
    kernel: str
    commit: str
    """The last one below the files that were judged."""
    files: str
    """Their mark (tests/case/left.py)."""
    scenes: dict[str, bool] = field(default_factory=dict)
    """Whether each held."""


def read(path: Path = REPORT) -> Report | None:
    """None: it was never run."""
    if not path.exists():
        return None
    found = json.loads(path.read_text())
    scenes = {row["scene"]: row["holds"] for row in found["scenes"]}
    return Report(found["date"], found["kernel"], found["commit"], found["files"], scenes)
