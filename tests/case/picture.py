"""The case as a picture: hazards on the left, a line to each claim that meets them, and what evidence it has."""

import textwrap
from collections.abc import Mapping
from html import escape
from typing import Final

from tests.case.case import Case, Claim
from tests.case.judge import Verdict

_LINE: Final = 15
_GAP: Final = 10
_HAZARD_X: Final = 20
_HAZARD_WIDTH: Final = 230
_CLAIM_X: Final = 370
_CLAIM_WIDTH: Final = 610
_COLOURS: Final = {Verdict.SHOWN: "#d8eed8", Verdict.PERSON: "#fbf0cc", Verdict.RED: "#f6cccc", None: "#eef2f8"}


def draw(case: Case, verdicts: Mapping[str, Verdict] | None = None) -> str:
    """An SVG; with verdicts each claim has its colour."""
    boxes: list[str] = []
    middles: dict[str, float] = {}
    y = 40.0
    for name, claim in case.claims.items():
        colour = _COLOURS[verdicts[name] if verdicts else None]
        height = _box(boxes, _CLAIM_X, y, _CLAIM_WIDTH, [*_wrapped(claim.text, 92), _evidence(claim)], colour)
        middles[name] = y + height / 2
        y += height + _GAP
    total = y
    lines: list[str] = []
    room = (total - 40) / len(case.hazards)
    for number, (name, hazard) in enumerate(case.hazards.items()):
        words = _wrapped(hazard.text, 32)
        top = 40 + number * room + (room - _height(words)) / 2
        height = _box(boxes, _HAZARD_X, top, _HAZARD_WIDTH, words, "#f2ece6")
        for claim_name in case.about(name):
            x1, y1, x2, y2 = _HAZARD_X + _HAZARD_WIDTH, top + height / 2, _CLAIM_X, middles[claim_name]
            bend = (x1 + x2) / 2
            way = f"M{x1} {y1:.0f} C{bend} {y1:.0f} {bend} {y2:.0f} {x2} {y2:.0f}"
            lines.append(f'<path d="{way}" fill="none" stroke="#8894a4"/>')
    width = _CLAIM_X + _CLAIM_WIDTH + 20
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{total:.0f}" '
            f'viewBox="0 0 {width} {total:.0f}" font-family="sans-serif" font-size="12">',
            '<rect width="100%" height="100%" fill="white"/>',
            f'<text x="{_HAZARD_X}" y="24" font-weight="bold">Hazard</text>',
            f'<text x="{_CLAIM_X}" y="24" font-weight="bold">Claim, and its evidence</text>',
            *lines,
            *boxes,
            "</svg>\n",
        ]
    )


def _evidence(claim: Claim) -> str:
    counts = (
        ("test", "tests", len(claim.tests) + len(claim.figures)),
        ("promise of the model check", "promises of the model check", len(claim.model)),
        ("mutation score", "mutation scores", len(claim.mutants)),
        ("benchmark row", "benchmark rows", len(claim.bench)),
        ("step of the drill", "steps of the drill", len(claim.drill)),
        ("for a person", "for a person", len(claim.person)),
        ("defeater", "defeaters", len(claim.defeaters)),
    )
    return " · ".join(f"{count} {one if count == 1 else many}" for one, many, count in counts if count)


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width)


def _height(words: list[str]) -> float:
    return len(words) * _LINE + 12


def _box(boxes: list[str], x: float, y: float, width: float, words: list[str], colour: str) -> float:
    height = _height(words)
    boxes.append(
        f'<rect x="{x}" y="{y:.0f}" width="{width}" height="{height:.0f}" rx="4" fill="{colour}" stroke="#8894a4"/>'
    )
    for number, line in enumerate(words):
        evidence = width == _CLAIM_WIDTH and number == len(words) - 1
        colour = "#5a6472" if evidence else "black"
        baseline = y + _LINE * (number + 1) + 1
        boxes.append(f'<text x="{x + 8}" y="{baseline:.0f}" fill="{colour}">{escape(line)}</text>')
    return height
