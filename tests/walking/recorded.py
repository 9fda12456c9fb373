"""Walks through a real gateway with a simulated controller, and the frames that it wrote."""

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from gateway.client import Walk
from gateway.people.walking import Odometry, Velocity
from schemas.telemetry import FrameRecord
from tests.support.gateway_process import Gateway
from tests.support.heard import frames

SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "telemetry": {"frames": True},
    "limits": {"leg_rate_hz": 60},  # at exactly the walk's rate setpoints wait for their slots
    "watchdog": {"timeout_ms": 10_000},  # it outlasts a moment in which this machine is busy
    "lease": {"ttl_ms": 10_000},
}


class Leg(NamedTuple):
    """A part of a course: a velocity, for so long."""

    name: str
    velocity: Velocity
    seconds: float


class Walked(NamedTuple):
    """One part as it was walked: when, in seconds since the first frame, and how far by its own reckoning."""

    part: Leg
    held_s: float
    """How long the velocity was commanded."""
    begin_s: float
    end_s: float
    """It stands."""
    begin: Odometry
    end: Odometry


class Recording(NamedTuple):
    """What a gateway wrote, and which part of it was what."""

    gait: str
    records: list[FrameRecord]
    parts: list[Walked]
    slowest_tick_ms: float


def record(folder: Path, gait: str, course: Sequence[Leg]) -> Recording:
    """Stand up, walk the parts with a stand between them, sit down, stop: in real time, through its own gateway."""
    with Gateway(folder, SETTINGS) as gateway, gateway.client(source="watcher") as watcher:
        written = frames(watcher)
        with gateway.client(source="walker") as robot:
            with robot.walk(gait) as walk:
                walk.stand()
                parts = [_walked(walk, part, lambda: written.all[-1].monotonic_ns) for part in course]
                slowest_ms = 1000 * walk.slowest_tick_s
            rejected = robot.state().commands.rejected
        assert rejected == 0
        written.wait(lambda each: each.monotonic_ns >= parts[-1].end_s, count=1)
        begun_ns = written.all[0].monotonic_ns
        timed = [
            each._replace(begin_s=(each.begin_s - begun_ns) / 1e9, end_s=(each.end_s - begun_ns) / 1e9)
            for each in parts
        ]
        return Recording(gait, written.all, timed, slowest_ms)


def _walked(walk: Walk, part: Leg, now_ns: Callable[[], int]) -> Walked:
    begin, begin_ns, begin_s = walk.state.odometry, now_ns(), time.monotonic()
    while time.monotonic() - begin_s < part.seconds:
        walk.go(*part.velocity)
    held_s = time.monotonic() - begin_s
    walk.stand()
    return Walked(part, held_s, begin_ns, now_ns(), begin, walk.state.odometry)


def directions(speed_m_s: float, seconds: float) -> list[Leg]:
    """Every 45 degrees: ahead, ahead to the left, left …"""
    names = ("forward", "forward left", "left", "backward left", "backward", "backward right", "right", "forward right")
    return [
        Leg(
            name,
            Velocity(speed_m_s * math.cos(math.tau * turn / 8), speed_m_s * math.sin(math.tau * turn / 8)),
            seconds,
        )
        for turn, name in enumerate(names)
    ]
