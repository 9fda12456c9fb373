"""examples/elkapod: where it lands is where the walk sits."""

from pathlib import Path
from typing import Final

import pytest

from examples.elkapod import gait
from gateway.geometry import load
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import STILL, Posture, Velocity
from gateway.people.walking.robot import Robot, ranges
from gateway.robot.runtime.report import limits_of
from gateway.robot.settings import Settings
from gateway.robot.settings import load as load_settings
from schemas.robot import JOINTS

FOLDER: Final = Path(gait.__file__).parent
SETTINGS: Final[Settings] = load_settings(FOLDER / "gateway.toml", simulated=True)
PERIOD_S: Final = 0.02
SECONDS: Final = 5.0


def test_it_lands_a_little_lower_than_the_walk_sits() -> None:
    """Servos give way under load, so that the belly is on the ground before they go slack (tests/falls)."""
    engine = Engine(Robot(load(gait.GEOMETRY), ranges(limits_of(SETTINGS), None)))
    for begin, velocity in ((engine.stand, STILL), (None, Velocity(gait.FORWARD_M_S)), (engine.sit, STILL)):
        if begin is not None:
            begin()
        for _ in range(round(SECONDS / PERIOD_S)):
            pose = engine.step(velocity, PERIOD_S)
            assert engine.limit == "", "the limits are wide enough for this velocity"
    assert engine.posture is Posture.SITTING
    lower = {
        10 * leg + joint: deg + (6.0 if joint == 2 else 0.0)
        for leg, angles in pose.items()
        for joint, deg in zip(JOINTS, angles, strict=True)
    }
    assert {int(name): deg for name, deg in SETTINGS.watchdog.landing.items()} == pytest.approx(lower, abs=0.5)
