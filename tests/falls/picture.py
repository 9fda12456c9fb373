"""The falls of all phases as an SVG: a row for each way of stopping, how fast the body went down in each phase."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.falls.fall import Fall

_COLUMN: Final = 190
_ROW: Final = 62
_LEFT: Final = 150
_TOP: Final = 40
_MOST_M_S: Final = 0.6
_GENTLE_M_S: Final = 0.2


def draw(path: Path, found: Sequence[tuple[str, str, Sequence[Fall]]]) -> None:
    """`found`: stance, way of stopping, and the fall in each phase."""
    stances = list(dict.fromkeys(stance for stance, _, _ in found))
    ways = list(dict.fromkeys(way for _, way, _ in found))
    width, height = _LEFT + _COLUMN * len(stances) + 20, _TOP + _ROW * len(ways) + 40
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" '
        'font-size="13">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    lines += [
        f'<text x="{_LEFT + _COLUMN * number}" y="22" font-weight="bold">{stance}</text>'
        for number, stance in enumerate(stances)
    ]
    for row, way in enumerate(ways):
        base = _TOP + _ROW * (row + 1) - 10
        lines.append(f'<text x="10" y="{base - 14}">{way}</text>')
        for column, stance in enumerate(stances):
            falls = next(falls for each, by, falls in found if (each, by) == (stance, way))
            lines += _bars(_LEFT + _COLUMN * column, base, falls)
    foot = (
        f"Bars: fastest speed downward in each phase of the stride; the line is {_GENTLE_M_S:g} m/s. Red: it fell over."
    )
    lines.append(f'<text x="10" y="{height - 12}" fill="#555">{foot}</text></svg>')
    path.write_text("\n".join(lines) + "\n")


def _bars(left: float, base: float, falls: Sequence[Fall]) -> list[str]:
    scale, wide = (_ROW - 16) / _MOST_M_S, (_COLUMN - 20) / max(len(falls), 12)
    lines = [
        f'<rect x="{left + wide * phase:.1f}" y="{base - scale * min(each.speed_m_s, _MOST_M_S):.1f}" '
        f'width="{wide * 0.8:.1f}" height="{scale * min(each.speed_m_s, _MOST_M_S):.1f}" '
        f'fill="{"#c03030" if each.fell_over else "#4070a8"}"/>'
        for phase, each in enumerate(falls)
    ]
    gentle = base - scale * _GENTLE_M_S
    right = left + _COLUMN - 20
    lines.append(f'<path d="M{left} {base} H{right} M{left} {gentle:.1f} H{right}" stroke="#999" stroke-width="0.7"/>')
    return lines
