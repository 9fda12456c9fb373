"""Standing up, sitting down and what lies between, from any pose; and a leg that somebody else stops."""

from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.geometry import load
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import Posture, Velocity
from gateway.people.walking.robot import Robot
from schemas.robot import LEGS
from tests.support.walked import Walked, feet_of, standing

pytestmark = pytest.mark.full

ROBOT: Final = Robot(load())
WAY_S: Final = 12.0
"""The longest way: folded legs, up, steps and the pose, each with slow servos."""
angles = st.tuples(*[st.floats(0, 1)] * 3)


@given(parts=st.fixed_dictionaries(dict.fromkeys(LEGS, angles)), missing=st.sets(st.sampled_from(LEGS)))
@settings(max_examples=12)
def test_from_any_pose_of_the_legs_that_run_it_stands_up_three_legs_at_a_time(
    parts: dict[int, tuple[float, float, float]], missing: set[int]
) -> None:
    """Whatever the servos were last commanded to, and whichever legs are slack."""
    pose = {}
    for leg in set(LEGS) - missing:
        limits = [ROBOT.ranges[10 * leg + joint] for joint in (1, 2, 3)]
        first, second, third = (
            each.min_deg + part * (each.max_deg - each.min_deg) for each, part in zip(limits, parts[leg], strict=True)
        )
        pose[leg] = first, second, third
    engine = Engine(ROBOT, angles_deg=pose)
    for leg, angles_deg in pose.items():
        assert engine.pose[leg] == pytest.approx(angles_deg)
    walked = Walked(engine)
    walked.checks_balance = False
    engine.stand()
    for _ in range(round(WAY_S / 0.02)):
        before = engine.pose
        walked.tick()
        if engine.posture is Posture.STANDING:
            break
        moved = [leg for leg in LEGS if engine.pose[leg] != before[leg]]
        on_belly = engine.body.height_m <= ROBOT.lying_m
        level = engine.body == walked.engine.body
        assert len(moved) <= 3 or not on_belly or level
    assert engine.posture is Posture.STANDING
    assert engine.body.height_m == pytest.approx(ROBOT.usual_m)
    walked.checks_balance = True
    walked.run(1.0, Velocity(0.1))


def test_a_lost_leg_in_any_phase_leaves_the_others_standing_still() -> None:
    walked = standing(ROBOT)
    walked.checks_balance = False  # which feet then carry is not ours to choose
    walked.run(2.0, Velocity(0.1))
    for _ in range(6):
        for lost in ((3,), (1, 4)):
            lose(walked.copy(), lost)
        walked.run(0.38, Velocity(0.1))


def lose(walked: Walked, lost: tuple[int, ...]) -> None:
    """These legs in this phase; the others stand still, and the walk goes on once they run again."""
    frozen = {leg: walked.engine.pose[leg] for leg in lost}
    walked.engine.halt(lost)
    walked.run(1.5, Velocity(0.1))
    assert walked.engine.posture is Posture.HALTED
    assert walked.engine.pose.keys() == set(LEGS) - set(lost)
    assert all(feet_of(walked.engine)[leg][2] == pytest.approx(0, abs=1e-9) for leg in walked.engine.pose)
    still = walked.engine.pose
    walked.run(1.0, Velocity(0.1))
    assert walked.engine.pose == still

    walked.engine.resume()
    assert {leg: walked.engine.pose[leg] for leg in lost} == frozen
    walked.pose = walked.engine.pose
    walked.until(Posture.STANDING, 1.0)
    walked.checks_balance = True
    x_m = walked.engine.odometry.x_m
    walked.run(1.5, Velocity(0.1))
    assert walked.engine.odometry.x_m > x_m + 0.1
