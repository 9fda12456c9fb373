"""The picture in docs/landing.md, from a real run: `python -m tests.support.landing_picture docs/landing.svg`.

A gateway on the simulated controller, and a program that walks with all six legs and then says no more. What is drawn
is every frame that was written: the angle that each servo was told, and when.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gateway.model.frames import Op
from schemas.robot import LEGS
from schemas.telemetry import Cause, Kind
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames
from tests.support.watch_picture import walk
from tests.support.way_down import Seen, reported

WALK_S: Final = 1.2
TIMEOUT_MS, LANDING_MS = 250.0, 1000.0
POSE: Final = {10 * leg + joint: angle for leg in LEGS for joint, angle in ((1, 90.0), (2, 25.0), (3, 150.0))}

WIDTH, HEIGHT = 860, 400
LEFT, RIGHT, TOP, BOTTOM = 52, 150, 44, 44
FROM_MS, TO_MS = -900.0, 1250.0
MOST_DEG: Final = 180
COLOURS: Final = ("#2a78d6", "#c4622d", "#3f8f4f")
INK, PALE, SHADE = "#333333", "#e3e3e3", "#f1f3f6"
JOINTS: Final = ("joint 1 → 90°", "joint 2 → 25°", "joint 3 → 150°")


class Run(NamedTuple):
    """All frames, and what the gateway's decisions were made at, in ms of its clock."""

    frames: list[Seen]
    last_command_ms: float
    landing_ms: float
    stops_ms: list[float]


def run(folder: Path) -> Run:
    """Walk, and fall silent."""
    settings: dict[str, dict[str, Any]] = {
        "telemetry": {"frames": True},
        "watchdog": {"timeout_ms": TIMEOUT_MS, "landing_ms": LANDING_MS, "repeats": 0},
        "watchdog.landing": {str(servo_id): angle for servo_id, angle in POSE.items()},
    }
    with Gateway(folder, settings) as gateway, gateway.client() as client:
        heard, told = frames(client), events(client)
        walk(client, LEGS, WALK_S)
        told.wait(lambda event: event.kind == Kind.WATCHDOG_EXPIRED)
        client.state()
        records = heard.all
    if sum(event.kind in (Kind.LANDING, Kind.WATCHDOG_EXPIRED) for event in told.all) > 2:
        sys.exit("this machine was so busy that the watchdog landed the robot twice; try again")
    ours = [record for record in records if record.cause is Cause.WATCHDOG]
    seen = reported(ours)
    commanded = reported(record for record in records if record.cause is Cause.COMMAND)
    first_leg_ms = max(each.at_ms for each in commanded if each.leg == 1)
    stops_ms = [each.at_ms for each in seen if each.frame.is_stop]
    return Run(reported(records), first_leg_ms, first_leg_ms + TIMEOUT_MS, stops_ms)


def picture(shown: Run) -> str:
    """The SVG."""
    zero_ms = shown.landing_ms
    marks = (
        (shown.last_command_ms, "last command"),
        (zero_ms, f"{TIMEOUT_MS:g} ms of silence: landing"),
        (shown.stops_ms[0], "six Stops"),
    )
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
        'font-family="sans-serif" font-size="13">',
        "<title>A landing: the angle that each of 18 servos is told, over time</title>",
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>',
        f'<rect x="{_x(0):.1f}" y="{TOP}" width="{_x(shown.stops_ms[0] - zero_ms) - _x(0):.1f}" '
        f'height="{HEIGHT - TOP - BOTTOM}" fill="{SHADE}"/>',
    ]
    for angle_deg in range(0, MOST_DEG + 1, 45):
        lines += [
            f'<path d="M{LEFT} {_y(angle_deg):.1f}H{WIDTH - RIGHT}" stroke="{PALE}"/>',
            _text(LEFT - 8, _y(angle_deg) + 4, f"{angle_deg}°", "end"),
        ]
    for at_ms in range(-750, 1251, 250):
        lines.append(_text(_x(at_ms), HEIGHT - BOTTOM + 18, f"{at_ms / 1000:g} s".replace("-", "−"), "middle"))
    for servo_id in sorted(POSE):
        points = _points(shown.frames, servo_id, zero_ms)
        lines.append(
            f'<polyline points="{points}" fill="none" stroke="{COLOURS[servo_id % 10 - 1]}" stroke-width="1.6"/>'
        )
    for number, (mark_ms, words) in enumerate(marks):
        x = _x(mark_ms - zero_ms)
        lines += [
            f'<path d="M{x:.1f} {TOP - 6}V{HEIGHT - BOTTOM}" stroke="{INK}" stroke-dasharray="4 3"/>',
            _text(x + (0 if number else -4), TOP - 12, words, ("end", "start", "middle")[number]),
        ]
    for words, angle_deg, colour in zip(JOINTS, (90, 25, 150), COLOURS, strict=True):
        lines.append(_text(WIDTH - RIGHT + 8, _y(angle_deg) + 4, words, "start", colour))
    lines.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 8, "after the silence was noticed", "middle"))
    return "\n".join([*lines, "</svg>"])


def _points(seen: Sequence[Seen], servo_id: int, zero_ms: float) -> str:
    """Each angle holds until the next one is told, and until the Stop."""
    points: list[str] = []
    y = None
    for at_ms, frame in seen:
        for each, op in frame.servos:
            if each == servo_id and at_ms - zero_ms >= FROM_MS:
                x = _x(at_ms - zero_ms)
                points += [] if y is None else [f"{x:.1f},{y:.1f}"]
                y = None if op.op is Op.STOP else _y(op.angle_cdeg / 100)
                points += [] if y is None else [f"{x:.1f},{y:.1f}"]
    return " ".join(points)


def _x(at_ms: float) -> float:
    return LEFT + (at_ms - FROM_MS) / (TO_MS - FROM_MS) * (WIDTH - LEFT - RIGHT)


def _y(angle_deg: float) -> float:
    return HEIGHT - BOTTOM - angle_deg / MOST_DEG * (HEIGHT - TOP - BOTTOM)


def _text(x: float, y: float, words: str, anchor: str, colour: str = INK) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{words}</text>'


def main() -> None:
    """Write the picture to the file named."""
    with tempfile.TemporaryDirectory() as folder:
        svg = picture(run(Path(folder)))
    Path(sys.argv[1]).write_text(svg + "\n")


if __name__ == "__main__":
    main()
