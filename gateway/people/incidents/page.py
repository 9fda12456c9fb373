"""One page to mail: an incident's story, its joints as they were commanded, and its Stops, over time."""

import math
from collections.abc import Sequence
from html import escape
from typing import Final

from gateway.model.frames import Op
from gateway.people.incidents.messages import incident_of
from gateway.people.recordings import RecordedMessage
from gateway.people.recordings.user_angles import frames_in
from schemas.robot import LEGS

_WIDTH: Final = 900
_LEFT: Final = 60
_ROW: Final = 70
"""Of a leg: 180° are 60 pixels high."""
_JOINTS: Final = {1: "#4878a8", 2: "#c07820", 3: "#609060"}
_STOP: Final = "#b03030"
_MOST_POINTS: Final = 4000
"""Of one servo; more could not be distinguished."""


def as_page(name: str, reported: Sequence[RecordedMessage], lines: Sequence[str]) -> str:
    """HTML in one file, without scripts and without anything from elsewhere."""
    incident = incident_of(reported)
    story = "\n".join(map(escape, lines))
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>{escape(name)}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
svg {{ width: 100%; font-size: 11px; }} pre {{ white-space: pre-wrap; }}
</style>
<h1>{escape(lines[0] if lines else name)}</h1>
<h2>Joints as they were commanded, and Stops</h2>
{_plot(reported, 0 if incident is None else incident.time_ns)}
<h2>The story</h2><pre>{story}</pre>
</html>
"""


def _plot(reported: Sequence[RecordedMessage], zero_ns: int) -> str:
    ways: dict[int, list[tuple[float, float]]] = {}
    stops: dict[int, list[float]] = {}
    frames = [((message.time_ns - zero_ns) / 1e9, frame) for message, frame in frames_in(reported)]
    if not frames:
        return "<p>No frame was written.</p>"
    begin_s = min(time_s for time_s, _ in frames)
    end_s = max(begin_s + 0.001, *(time_s for time_s, _ in frames))
    for time_s, frame in frames:
        for servo_id, command in frame.servos:
            if command.op is Op.STOP:
                stops.setdefault(servo_id // 10, []).append(time_s)
                ways.setdefault(servo_id, []).append((time_s, math.nan))
            else:
                ways.setdefault(servo_id, []).append((time_s, command.angle_cdeg / 100))

    def x(time_s: float) -> float:
        return _LEFT + (_WIDTH - _LEFT - 20) * (time_s - begin_s) / (end_s - begin_s)

    def y(leg: int, angle_deg: float) -> float:
        return leg * _ROW - angle_deg / 3

    drawn = []
    for leg in LEGS:
        drawn.append(f'<text x="4" y="{leg * _ROW - 26}">leg {leg}</text>')
        drawn.append(f'<path d="M{_LEFT} {leg * _ROW} H{_WIDTH - 20}" stroke="#ddd"/>')
        for time_s in dict.fromkeys(stops.get(leg, ())):
            title = f"Stop at {1000 * time_s:+.1f} ms"
            at = f"M{x(time_s):.1f} {leg * _ROW} v-60"
            drawn.append(f'<path d="{at}" stroke="{_STOP}"><title>{title}</title></path>')
        for joint, colour in _JOINTS.items():
            for piece in _pieces(ways.get(leg * 10 + joint, ())):
                points = " ".join(f"{x(time_s):.1f},{y(leg, angle_deg):.1f}" for time_s, angle_deg in piece)
                drawn.append(f'<polyline points="{points}" fill="none" stroke="{colour}"/>')
    height = (max(LEGS)) * _ROW + 40
    legend = " ".join(f'<tspan fill="{colour}">joint {joint}</tspan>' for joint, colour in _JOINTS.items())
    zero = (
        f'<path d="M{x(0):.1f} 8 V{height - 30}" stroke="#888" stroke-dasharray="3"/>' if begin_s <= 0 <= end_s else ""
    )
    return (
        f'<svg viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="joints and Stops over time">'
        f"{zero}{''.join(drawn)}"
        f'<text x="{_LEFT}" y="{height - 8}">{begin_s:+.2f} to {end_s:+.2f} s; 0 to 180° a row; {legend}, '
        f'<tspan fill="{_STOP}">a Stop</tspan>; dashed: the incident</text></svg>'
    )


def _pieces(way: Sequence[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """The way between two Stops, thinned to what can be seen."""
    step = max(1, len(way) // _MOST_POINTS)
    pieces: list[list[tuple[float, float]]] = [[]]
    for number, (time_s, angle_deg) in enumerate(way):
        if math.isnan(angle_deg):  # a Stop
            if pieces[-1]:
                pieces.append([])
        elif number % step == 0:
            pieces[-1].append((time_s, angle_deg))
    return [piece for piece in pieces if piece]
