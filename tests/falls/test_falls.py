"""What stops do to a robot (docs/stops.md). That a gateway writes a landing as computed: tests/hil/test_landing.py."""

from copy import deepcopy
from functools import cache, reduce
from itertools import product
from typing import Final

import pytest

from gateway.people.physics.assumed import Assumed
from gateway.people.walking.gaits import GAITS
from tests.falls.fall import AFTER_S, SLACK, Fall, landed, looked_at
from tests.falls.stride import GEOMETRY, SETTINGS, STANCES, STAND, Moment, moments
from tests.walking.physics import FALLEN_DEG, SINKS_S, SUNK_M, run


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
