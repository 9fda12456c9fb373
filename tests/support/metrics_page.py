"""The metrics page, and its list in docs/recordings.md: the name, kind and labels of each metric."""

import re
from pathlib import Path
from typing import Final

from prometheus_client.parser import text_string_to_metric_families

Described = set[tuple[str, str, frozenset[str]]]
_DOCS: Final = Path(__file__).parents[2] / "docs" / "recordings.md"
_OF: Final = re.compile(r"^For a robot ", re.MULTILINE)


def documented(robot: str = "") -> Described:
    """Return what the docs list for every robot, or for one "that measures" or "with a power board"."""
    always, *further = _OF.split(_DOCS.read_text())
    (section,) = [each for each in further if each.startswith(robot)] if robot else [always]
    rows = re.findall(r"^\| `((?:hexapod|process)_\w+)` \| (\w+) \| (.*?) \|", section, re.MULTILINE)
    return {(name, kind, frozenset(re.findall(r"`(\w+)`", labels))) for name, kind, labels in rows}


def described(page: str) -> Described:
    """Return what a page has."""
    found = set()
    for each in text_string_to_metric_families(page):
        labels = frozenset(label for sample in each.samples for label in sample.labels) - {"le"}
        name = f"{each.name}_total" if each.type == "counter" else each.name
        found.add((name, "info" if name.endswith("_info") else each.type, labels))
    return found
