"""What stops do to a robot, and that a real gateway writes what is computed for it (docs/stops.md)."""

import os
from copy import deepcopy
from functools import cache, reduce
from itertools import product
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.geometry import load
from gateway.people.physics.assumed import Assumed
from gateway.people.physics.world import World
from gateway.people.walking import GAITS
from gateway.robot.settings import Settings
from schemas.robot import LEGS
from schemas.telemetry import Cause
from tests.falls.fall import AFTER_S, SLACK, Fall, landed, looked_at
from tests.falls.stride import ELKAPOD, GEOMETRY, SETTINGS, STANCES, STAND, Moment, moments
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import frames, is_stop
from tests.walking.physics import FALLEN_DEG, SINKS_S, SUNK_M, drive, run, sent_by


@cache
def six_moments(stance: str, assumed: Assumed) -> list[Moment]:
    """Whoever goes on with one takes a copy."""
    return moments(stance, assumed)


WEAK: Final = "servos of 1.4 N·m"
WORLDS: Final = {
    "as assumed": Assumed(),
    WEAK: Assumed(torque_nm=1.4),
    "3.5 kg": Assumed(mass_kg=3.5),
    "5.0 kg, servos of 3.5 N·m": Assumed(mass_kg=5.0, torque_nm=3.5),
    "friction 0.5": Assumed(friction=0.5),
}
"""The last but one is what the Elkapod's own description adds up to, with servos that carry it."""
HARDEST: Final = (STAND, "tripod")
"""The fewest feet carry a tripod; the gaits with more of them go in two worlds only."""
MOST_SPEED_M_S: Final = 0.2
MOST_TILT_DEG: Final = 10.0
"""What a landing may do."""
STUCK_M_S: Final = 0.8
STUCK: Final = {(WEAK, "tripod"), ("3.5 kg", "tripod")}
"""Servos too weak for their robot to push a loaded foot outward over rubber: from some phases of a tripod walk two feet
hold it up like a trestle, and let go at once (docs/stops.md)."""


@pytest.mark.parametrize(
    ("world", "stance"),
    [pair for pair in product(WORLDS, STANCES) if pair[1] in HARDEST or pair[0] in ("as assumed", WEAK)],
)
def test_a_landing_from_any_phase_is_gentle(world: str, stance: str) -> None:
    each = (
        looked_at(deepcopy(moment.world), landed(moment.angles, SETTINGS), GEOMETRY)
        for moment in six_moments(stance, WORLDS[world])
    )
    found = reduce(Fall.worse, each)
    assert found.speed_m_s < (STUCK_M_S if (world, stance) in STUCK else MOST_SPEED_M_S)
    assert found.tilt_deg < MOST_TILT_DEG
    assert found.drop_m > 0.08, "it stood"


@pytest.mark.parametrize("gait", GAITS)
def test_a_stop_in_any_phase_of_a_stride_lets_it_sink_and_never_topple(gait: str) -> None:
    """All servos slack, as after an emergency stop, at six times within a stride: faster down than by a landing."""
    for moment in six_moments(gait, Assumed()):
        world = deepcopy(moment.world)
        fallen = looked_at(world, [(0.0, SLACK)], GEOMETRY)
        assert fallen.speed_m_s > MOST_SPEED_M_S
        assert fallen.tilt_deg < FALLEN_DEG
        run(world, SINKS_S - AFTER_S)
        assert world.body().position_m[2] < SUNK_M


# ---- what a real gateway writes

WALKED_M: Final = 0.04
"""In four seconds, of which it gets up in three, and then walks at 8 cm/s."""
DOWN_DEG: Final = {1: 90.0, 2: 162.0, 3: 108.0}


def landing_settings() -> dict[str, dict[str, Any]]:
    """The Elkapod's landing, as the default geometry counts."""
    elkapod, geometry = load(ELKAPOD / "geometry.json"), load()
    pose = {
        str(10 * leg + joint): geometry.servos[10 * leg + joint].servo_deg(elkapod.joint_rad(10 * leg + joint, deg))
        for leg in LEGS
        for joint, deg in DOWN_DEG.items()
    }
    return {
        "telemetry": {"frames": True},
        "limits": {"leg_rate_hz": 60},
        # The timeout outlasts a moment in which this machine is busy.
        "watchdog": {"timeout_ms": 1000, "landing_ms": SETTINGS.watchdog.landing_ms},
        "watchdog.landing": pose,
    }


def test_a_real_gateways_frames_let_it_walk_and_land_as_computed(tmp_path: Path) -> None:
    """A program that walks by the clock is killed: what is computed for its silence, and what the gateway wrote."""
    settings = landing_settings()
    with Gateway(tmp_path, settings) as gateway, gateway.client() as client:
        heard = frames(client)
        walk = [*COMMAND, "walk", "--forward", "0.08", "--seconds", "60", "--connect", gateway.endpoint]
        walker = Child(walk, os.environ)
        heard.wait(lambda frame: frame.cause == Cause.COMMAND, count=6 * 200, timeout_s=40)
        walker.kill()
        last = heard.wait(lambda frame: is_stop(frame) and frame.cause == Cause.WATCHDOG, count=6)
        walker.close()
        written = [record for record in heard.all if record.monotonic_ns <= last.monotonic_ns]
    commands = [record for record in written if record.cause == Cause.COMMAND]
    begun_ns, silent_ns = commands[0].monotonic_ns, commands[-1].monotonic_ns
    geometry, world = load(), World(load())
    commanded: dict[int, float] = {}
    for at_s, angles in sent_by(commands, begun_ns):
        while world.time_s < at_s:
            world.step()
        drive(world, angles, geometry)
        commanded |= {servo_id: deg for servo_id, deg in angles.items() if deg is not None}
    assert world.body().position_m[0] > WALKED_M
    there = deepcopy(world)
    after = [record for record in written if record.monotonic_ns > silent_ns]
    real = looked_at(world, sent_by(after, silent_ns), geometry)
    rules = Settings.of(nested(settings))
    computed = looked_at(there, landed(commanded, rules), geometry)
    assert real.drop_m == pytest.approx(computed.drop_m, abs=0.005)
    assert real.speed_m_s == pytest.approx(computed.speed_m_s, abs=0.05)
    assert real.tilt_deg == pytest.approx(computed.tilt_deg, abs=2.0)
    assert real.speed_m_s < MOST_SPEED_M_S


def nested(settings: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """As TOML reads `[watchdog.landing]`."""
    watchdog = {**settings["watchdog"], "landing": settings.get("watchdog.landing", {})}
    return {"limits": settings["limits"], "watchdog": watchdog}
