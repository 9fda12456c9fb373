"""Uneven ground in physics: with sensors the body leans half as much, and it walks over no edge."""

from functools import cache
from typing import Final

import pytest

from tests.walking.uneven import COURSES, SENSORS, Outcome, walk

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
