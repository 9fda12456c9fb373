"""The metrics page, and its list in docs/recordings.md: the name, kind and labels of each metric."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.samples import Sample

Described = set[tuple[str, str, frozenset[str]]]
_DOCS: Final = Path(__file__).parents[2] / "docs" / "recordings.md"
_OF: Final = re.compile(r"^For a robot ", re.MULTILINE)


def documented(robot: str = "") -> Described:
    """What the docs list for every robot, or for one "that measures" or "with a power board"."""
    always, *further = _OF.split(_DOCS.read_text())
    (section,) = [each for each in further if each.startswith(robot)] if robot else [always]
    rows = re.findall(r"^\| `((?:hexapod|process)_\w+)` \| (\w+) \| (.*?) \|", section, re.MULTILINE)
    return {(name, kind, frozenset(re.findall(r"`(\w+)`", labels))) for name, kind, labels in rows}


def described(page: str) -> Described:
    """What a page has."""
    return {_described(family.name, family.type, family.samples) for family in text_string_to_metric_families(page)}


def _described(name: str, kind: str, samples: Iterable[Sample]) -> tuple[str, str, frozenset[str]]:
    labels = frozenset(label for sample in samples for label in sample.labels) - {"le"}
    return f"{name}_total" if kind == "counter" else name, "info" if name.endswith("_info") else kind, labels
