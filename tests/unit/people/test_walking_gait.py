"""The gait engine: what holds at every tick, over all gaits, directions, phases and changes; and literal walks."""

import math
import tomllib
from functools import cache
from pathlib import Path
from typing import Final

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.errors import WalkError
from gateway.geometry import load
from gateway.people.walking import GAITS, STILL, Engine, Posture, Range, Robot, Velocity
from gateway.people.walking.gaits import NUMBERS, gait, phase
from gateway.people.walking.motion import BodyPose
from gateway.people.walking.robot import check_mirrored_once
from gateway.robot.settings import load as load_settings
from schemas.calibration import Calibration
from schemas.robot import LEGS
from tests.support.walked import TICK_S, standing

pytestmark = pytest.mark.full

ELKAPOD: Final = Path(__file__).parents[3] / "examples" / "elkapod"


@cache
def robot(name: str) -> Robot:
    """The default one, and the example's with its limits and speeds; `slow` has servos of a third of the speed."""
    if name == "elkapod":
        limits = load_settings(ELKAPOD / "gateway.toml", simulated=True).limits.servos
        ranges = {int(key): Range(each.min_deg, each.max_deg, each.max_speed_deg_s) for key, each in limits.items()}
        return Robot(load(ELKAPOD / "geometry.json"), ranges)
    speeds = {10 * leg + joint: Range(max_speed_deg_s=90.0) for leg in LEGS for joint in (1, 2, 3)}
    return Robot(load(), speeds if name == "slow" else {})


names = st.sampled_from(("default", "elkapod", "slow"))
gaits = st.sampled_from(sorted(GAITS))
velocities = st.one_of(
    st.builds(Velocity, *[st.floats(-0.3, 0.3)] * 2, st.floats(-1.0, 1.0)),
    st.builds(
        lambda angle, speed: Velocity(speed * math.cos(angle), speed * math.sin(angle)), st.floats(0, 6.3), st.just(0.1)
    ),
    st.just(STILL),
)
walks = st.lists(st.tuples(velocities, st.integers(1, 100)), min_size=1, max_size=4)


@given(name=names, of=gaits, walk=walks)
@settings(max_examples=15)
def test_whatever_it_is_asked_for_it_keeps_its_limits_and_does_not_fall(
    name: str, of: str, walk: list[tuple[Velocity, int]]
) -> None:
    """Angles, speeds, three feet, the centre of mass, rigid stances, slewed velocities: `Walked` checks each tick."""
    walked = standing(robot(name), of)
    for velocity, ticks in walk:
        for _ in range(ticks):
            walked.tick(velocity)
    walked.until(Posture.STANDING, 4 * GAITS[of].period_s)


@given(of=gaits, then=gaits, velocity=velocities, after=st.integers(0, 200))
@example(of="wave", then="ripple", velocity=Velocity(0.1), after=126)  # a foot is left outside the new gait's disc
@example(of="wave", then="tripod", velocity=Velocity(0.1), after=116)
@example(of="wave", then="tripod", velocity=Velocity(0.1), after=128)
@settings(max_examples=8)
def test_another_gait_in_any_phase_is_no_jump(of: str, then: str, velocity: Velocity, after: int) -> None:
    walked = standing(robot("default"), of)
    for _ in range(after):
        walked.tick(velocity)
    walked.engine.walk_as(then)
    walked.run(3.0, velocity)
    assert walked.engine.gait_name == then
    assert walked.engine.posture is (Posture.WALKING if velocity.moves else Posture.STANDING)


@pytest.mark.parametrize("of", sorted(GAITS))
def test_a_walk_ends_in_any_phase_within_a_stride_on_six_feet(of: str) -> None:
    walked = standing(robot("default"), of)
    walked.run(2.0, Velocity(0.3, 0.05))
    for _ in range(7):
        ended = walked.copy()
        ended.until(Posture.STANDING, GAITS[of].period_s)
        assert len(ended.engine.standing) == 6
        assert all(foot[2] == 0 for foot in ended.engine.feet.values())
        walked.run(0.46, Velocity(0.3, 0.05))


@pytest.mark.parametrize("of", sorted(GAITS))
@pytest.mark.parametrize(
    "velocity", [Velocity(0.02), Velocity(-0.02), Velocity(0, 0.02), Velocity(0, 0, 0.05), Velocity(0.015, 0, 0.03)]
)
def test_it_goes_where_it_was_sent(of: str, velocity: Velocity) -> None:
    walked = standing(robot("default"), of)
    walked.run(5.0, velocity)
    walked.until(Posture.STANDING, 4.0)
    went, turned = walked.engine.odometry[:2], walked.engine.odometry.heading_rad
    assert turned == pytest.approx(5 * velocity.turn_rad_s, abs=0.025)
    assert math.hypot(*went) == pytest.approx(5 * math.hypot(*velocity[:2]), abs=0.01)
    assert walked.engine.scaled == STILL
    assert walked.engine.limit == ""


@pytest.mark.parametrize("of", sorted(GAITS))
def test_what_is_too_fast_is_scaled_down_as_a_whole_and_said(of: str) -> None:
    wanted = Velocity(0.6, -0.3, 0.9)
    walked = standing(robot("default"), of)
    walked.run(5.0, wanted)
    engine = walked.engine
    assert engine.commanded == wanted
    factor = engine.scaled.forward_m_s / wanted.forward_m_s
    assert 0 < factor < 1
    assert engine.scaled == pytest.approx(wanted.times(factor))
    slower = engine.scaled.forward_m_s / engine.velocity.forward_m_s  # where servos are too slow, time is slowed down
    assert 0.7 < slower <= 1
    assert engine.scaled == pytest.approx(engine.velocity.times(slower), abs=1e-6)
    assert "the legs' strides reach" in engine.limit


@pytest.mark.parametrize(("of", "forward_m_s", "turn_rad_s", "part"), [
    ("tripod", 0.15, 0.5, 0.86), ("ripple", 0.10, 0.25, 0.89), ("wave", 0.05, 0.10, 0.94),
])  # fmt: skip
def test_the_elkapods_own_limits_are_reached_at_the_same_time(
    of: str, forward_m_s: float, turn_rad_s: float, part: float
) -> None:
    """With servos of 300 degrees a second; the limit names the servo that is too slow for the rest."""
    for wanted in (Velocity(forward_m_s), Velocity(0, 0, turn_rad_s), Velocity(forward_m_s, 0, turn_rad_s)):
        walked = standing(robot("default"), of)
        walked.run(4.0, wanted)
        before_rad, before_m = walked.engine.odometry.heading_rad, walked.engine.odometry
        walked.run(3.0, wanted)
        least = part if all((wanted.forward_m_s, wanted.turn_rad_s)) else 0.99
        assert walked.engine.odometry.heading_rad - before_rad >= least * 3.0 * wanted.turn_rad_s
        if not wanted.turn_rad_s:
            assert walked.engine.odometry.x_m - before_m.x_m >= least * 3.0 * wanted.forward_m_s
        walked.until(Posture.STANDING, GAITS[of].period_s)


def test_slow_servos_slow_everything_down_and_it_says_so() -> None:
    walked = standing(robot("slow"))
    walked.run(8.0, Velocity(0.05))
    assert "the speed of servo" in walked.engine.limit
    assert 0.01 < walked.engine.scaled.forward_m_s < 0.045
    assert walked.engine.odometry.x_m < 0.36


def test_limits_that_leave_no_stride_leave_a_robot_that_stands() -> None:
    stiff = {10 * leg + 1: Range(89.0, 91.0) for leg in LEGS}
    walked = standing(Robot(load(), stiff))
    with pytest.raises(WalkError, match=r"its limits leave it no stride 0\.15\d* m high: servo 11 would stand at"):
        walked.engine.stance.check_walks()


def test_a_geometry_that_mirrors_what_the_calibration_mirrors_is_rejected() -> None:
    """The default file counts as the wire does, the Elkapod's as commands do; its calibration lies between them."""
    with (ELKAPOD / "calibration.toml").open("rb") as file:
        calibration = Calibration(revision=1, landing={}, servos=tomllib.load(file)["servos"])
    check_mirrored_once(load(), None)
    check_mirrored_once(load(), calibration.model_copy(update={"servos": {}}))
    check_mirrored_once(load(ELKAPOD / "geometry.json"), calibration)
    with pytest.raises(WalkError, match=r"servos 22, 42, 62 are turned round by the calibration, and by the geometry"):
        check_mirrored_once(load(), calibration)


def test_a_tick_that_comes_late_makes_no_leap() -> None:
    walked = standing(robot("default"))
    walked.run(2.0, Velocity(0.1))
    walked.tick(Velocity(0.1), 3.0)
    walked.run(1.0, Velocity(0.1))


def test_a_height_that_the_legs_cannot_reach_is_an_error_that_says_why() -> None:
    for height_m in (0.02, 0.4, -1.0):
        with pytest.raises(WalkError, match="it cannot stand"):
            robot("default").stance(BodyPose(height_m))
    with pytest.raises(WalkError, match="are finite numbers"):
        robot("default").stance(BodyPose(math.nan))


@pytest.mark.parametrize(
    "numbers", [(math.nan, 0, 0), (0, math.inf, 0), (0, 0, -11), (1e9, 0, 0), (True, 0, 0), ("1", 0, 0), (None, 0, 0)]
)
def test_what_is_no_velocity_is_rejected(numbers: tuple[float, float, float]) -> None:
    with pytest.raises(WalkError, match=r"a velocity is a finite number|no walking robot does"):
        Velocity.checked(*numbers)


def test_a_gait_that_there_is_not_is_rejected() -> None:
    with pytest.raises(WalkError, match=f"there is no gait 'gallop'; there are {', '.join(GAITS)}"):
        Engine(robot("default"), "gallop")


def test_the_bridge_numbers_every_gait_of_the_table_and_the_elkapods_as_it_does() -> None:
    assert [NUMBERS[number] for number in range(3)] == ["wave", "ripple", "tripod"]
    assert sorted(NUMBERS.values()) == sorted(GAITS)


@pytest.mark.parametrize(("of", "most"), [("tripod", 3), ("ripple", 2), ("wave", 1)])
def test_the_table_lifts_no_more_than_the_gaits_name_says(of: str, most: int) -> None:
    swings = [sum(phase(gait(of), leg, clock / 1000) < 1 - gait(of).duty for leg in LEGS) for clock in range(1000)]
    assert max(swings) == most
    assert min(swings) <= most - 1 or of == "ripple"


def test_one_stride_puts_every_foot_back_under_its_place() -> None:
    """After the first strides of a start, landings are half a stride ahead and lifts half a stride behind."""
    walked = standing(robot("default"))
    engine = walked.engine
    walked.run(3.0, Velocity(0.1))
    ahead: dict[int, list[float]] = {leg: [] for leg in LEGS}
    for _ in range(round(gait("tripod").period_s / TICK_S)):
        walked.tick(Velocity(0.1))
        for leg in engine.standing:
            ahead[leg].append(engine.feet[leg][0] - engine.stance.feet[leg][0])
    for offsets in ahead.values():
        assert max(offsets) == pytest.approx(0.1 * gait("tripod").stance_s / 2, abs=0.003)
        assert min(offsets) == pytest.approx(-0.1 * gait("tripod").stance_s / 2, abs=0.003)
