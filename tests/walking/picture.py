"""The paths of all worlds from above, as an SVG."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from tests.walking.physics import Track

_SCALE: Final = 220.0
"""Pixels a metre."""
_EDGE: Final = 30.0
_COLOURS: Final = ("#2060a0", "#a05020", "#208050")


def draw(path: Path, tracks: Mapping[str, Sequence[Track]]) -> None:
    """`tracks`: of each gait, all worlds; the first is drawn thick."""
    points = [(pose.x_m, pose.y_m) for each in tracks.values() for track in each for pose in track.poses]
    left, right = min(x for x, _ in points), max(x for x, _ in points)
    low, high = min(y for _, y in points), max(y for _, y in points)
    width, height = (right - left) * _SCALE + 2 * _EDGE, (high - low) * _SCALE + 2 * _EDGE + 20 * len(tracks)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" font-family="sans-serif">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for (gait, worlds), colour in zip(tracks.items(), _COLOURS, strict=False):
        for number, track in enumerate(worlds):
            path_points = " ".join(
                f"{(pose.x_m - left) * _SCALE + _EDGE:.1f},{(high - pose.y_m) * _SCALE + _EDGE:.1f}"
                for pose in track.poses[::5]
            )
            stroke = 2.0 if number == 0 else 0.6
            lines.append(f'<polyline points="{path_points}" fill="none" stroke="{colour}" stroke-width="{stroke}"/>')
        y = height - 20 * (len(tracks) - list(tracks).index(gait)) + 12
        words = f"{gait}: {len(worlds)} worlds"
        lines.append(f'<text x="{_EDGE}" y="{y:.0f}" font-size="14" fill="{colour}">{words}</text>')
    x, y = width - _EDGE - _SCALE / 2, height - 12
    lines.append(f'<path d="M{x:.0f} {y:.0f} h{_SCALE / 2:.0f}" stroke="black"/>')
    lines.append(f'<text x="{x:.0f}" y="{y - 5:.0f}" font-size="12">0.5 m</text></svg>')
    path.write_text("\n".join(lines) + "\n")
