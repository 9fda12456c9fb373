"""examples/elkapod: where it lands is where the walk sits."""

from functools import cache
from pathlib import Path
from typing import Final

import pytest

from examples.elkapod import gait
from gateway.geometry import load
from gateway.people.walking import STILL, Engine, Pose, Posture, Robot, Velocity
from gateway.people.walking.robot import ranges
from gateway.robot.runtime.report import limits_of
from gateway.robot.settings import Settings
from gateway.robot.settings import load as load_settings
from schemas.robot import JOINTS

FOLDER: Final = Path(gait.__file__).parent
SETTINGS: Final[Settings] = load_settings(FOLDER / "gateway.toml", simulated=True)
PERIOD_S: Final = 0.02
WALK_S: Final = 10.0


@cache
def walked() -> tuple[tuple[Posture, Pose], ...]:
    """What the program makes of the geometry and the limits, tick by tick: it lies, stands up, walks and sits down."""
    engine = Engine(Robot(load(gait.GEOMETRY), ranges(limits_of(SETTINGS), None)))
    ticks = [(engine.posture, engine.pose)]

    def tick(velocity: Velocity = STILL) -> Posture:
        ticks.append((engine.posture, engine.step(velocity, PERIOD_S)))
        return engine.posture

    engine.stand()
    while tick() is not Posture.STANDING:
        assert engine.limit == ""
    for _ in range(round(WALK_S / PERIOD_S)):
        tick(Velocity(gait.FORWARD_M_S))
        assert engine.limit == "", "the limits are wide enough for this velocity"
    engine.sit()
    while tick() is not Posture.SITTING:
        assert len(ticks) * PERIOD_S < 2 * WALK_S
    return tuple(ticks)


def servos_deg(pose: Pose) -> dict[int, float]:
    return {10 * leg + joint: angle for leg, three in pose.items() for joint, angle in zip(JOINTS, three, strict=True)}


def test_it_lands_a_little_lower_than_the_walk_sits() -> None:
    """Servos give way under load, so that the belly is on the ground before they go slack (tests/falls)."""
    posture, sitting = walked()[-1][0], servos_deg(walked()[-1][1])
    assert posture in (Posture.MOVING, Posture.SITTING)
    lower = {servo_id: deg + (6.0 if servo_id % 10 == 2 else 0.0) for servo_id, deg in sitting.items()}
    assert {int(name): deg for name, deg in SETTINGS.watchdog.landing.items()} == pytest.approx(lower, abs=0.5)
