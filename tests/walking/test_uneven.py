"""Uneven ground in physics: with sensors the body leans half as much, and it walks over no edge."""

from functools import cache
from typing import Final

import pytest

from gateway.geometry.masses import MASSES
from gateway.people.physics.assumed import Assumed, Terrain
from gateway.people.physics.world import World
from gateway.people.walking import STILL, Engine, Posture, Velocity
from tests.walking.physics import TICK_S, angles_of, drive, run
from tests.walking.uneven import COURSES, GEOMETRY, ROBOT, SENSORS, Course, Outcome, late, measured, true, walk

HALF: Final = 0.5


@cache
def blind(name: str) -> Outcome:
    """Without sensors."""
    return walk(COURSES[name], adapts=False)


@pytest.mark.parametrize("name", ["slope 8 up", "slope 15 up", "step 20 mm"])
def test_on_uneven_ground_the_body_leans_at_most_half_as_much(name: str) -> None:
    feels = walk(COURSES[name], adapts=True)
    assert not feels.fell
    assert feels.tilt_deg <= HALF * blind(name).tilt_deg
    assert feels.went_m > 0.9 * blind(name).went_m


def test_on_a_flat_floor_it_goes_nine_tenths_as_far_as_blind() -> None:
    course = COURSES["flat"]._replace(seconds=6.0)
    assert walk(course, adapts=True).went_m >= 0.9 * walk(course, adapts=False).went_m


@pytest.mark.parametrize("fault", ["", *SENSORS])
def test_it_stands_still_before_an_edge_that_a_blind_walk_goes_over(fault: str) -> None:
    sensor = SENSORS[fault]() if fault else None
    course = COURSES["edge"]._replace(seconds=6.0)
    felt = walk(course, adapts=True) if sensor is None else walk(course, adapts=True, sensor=sensor)
    assert "no ground under leg" in felt.limit
    assert felt.worst_deg < 5.0


@pytest.mark.parametrize("fault", SENSORS)
def test_wrong_sensors_leave_it_no_more_tilted_than_blind_and_it_arrives(fault: str) -> None:
    felt = walk(COURSES["step 20 mm"], adapts=True, sensor=SENSORS[fault]())
    assert felt.tilt_deg <= blind("step 20 mm").tilt_deg
    assert felt.worst_deg <= blind("step 20 mm").worst_deg
    assert felt.went_m > 0.8 * blind("step 20 mm").went_m


def test_lifted_off_the_ground_it_stands_still_and_names_it() -> None:
    lifted = walk(Course(Terrain(), seconds=4.0, lift_n=1.2 * 9.81 * MASSES.total_kg), adapts=True)
    assert "somebody has lifted it" in lifted.limit


def test_by_its_sensors_it_sits_down_on_its_belly_and_stands_up_again() -> None:
    engine, world = Engine(ROBOT), World(GEOMETRY, Assumed())
    world.lie_down({servo_id: GEOMETRY.joint_rad(servo_id, deg) for servo_id, deg in angles_of(engine).items()})
    for posture in (Posture.STANDING, Posture.SITTING, Posture.STANDING):
        engine.sit() if posture is Posture.SITTING else engine.stand()
        for _ in range(250):
            engine.step(STILL, TICK_S, measured(world, true))
            drive(world, angles_of(engine), GEOMETRY)
            run(world, TICK_S)
        assert engine.posture is posture, engine.limit


def test_late_sensors_on_a_flat_floor_make_it_lean_no_more_than_blind() -> None:
    course = COURSES["flat"]._replace(seconds=6.0, velocity=Velocity(0.06))
    unfelt, felt = walk(course, adapts=False), walk(course, adapts=True, sensor=late())
    assert felt.worst_deg <= unfelt.worst_deg + 0.5
    assert felt.went_m > 0.7 * unfelt.went_m
