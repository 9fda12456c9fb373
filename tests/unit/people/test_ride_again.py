"""Starting again after any Stops, silences and resets: no leg leaps, and what lies is not said to stand."""

from collections.abc import Callable
from typing import Final

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from gateway.errors import GatewayError, StoppedError
from gateway.people.walking.motion import STILL, Posture, Velocity
from gateway.people.walking.ride import Phase
from gateway.people.walking.robot import Robot
from schemas.robot import LEGS
from tests.support.ridden import FED_SINGLY, ROBOT, TICK_S, WHOLE, Ridden, standing

AHEAD: Final = Velocity(0.1)
ALL: Final = tuple(LEGS)
legs = st.sets(st.sampled_from(LEGS), min_size=1)


def walking(seconds: float = 1.0) -> Ridden:
    ridden = standing()
    walks(ridden, seconds)
    return ridden


def walks(ridden: Ridden, seconds: float) -> None:
    for _ in range(round(seconds / TICK_S)):
        ridden.ride.go(AHEAD, ridden.now_s)
        ridden.tick()


def expect_begins_anew(ridden: Ridden) -> None:
    """Nothing runs and nothing is sent by `start_again` alone; then all six start, one after the other, from lying."""
    ridden.ride.start_again()
    sent = len(ridden.sent)
    ridden.run(0.2)
    assert ridden.ride.error is None
    assert (ridden.ride.phase, ridden.posture, len(ridden.sent)) == (Phase.RESTS, Posture.LYING, sent)
    assert not ridden.running
    ridden.started.clear()
    ridden.ride.go(AHEAD, ridden.now_s)
    ridden.until(lambda: ridden.posture is Posture.STANDING)
    assert [leg for _, leg in ridden.started] == list(LEGS)


def test_after_a_lost_leg_and_an_emergency_stop_it_begins_anew_lying() -> None:
    ridden = walking()
    ridden.stop([3])
    ridden.run(0.5)
    assert ridden.posture is Posture.HALTED
    ridden.estop()
    ridden.run(3.0)
    assert ridden.ride.state.lost == ALL
    assert "others stand still" not in str(ridden.ride.error)
    ridden.estopped = False
    expect_begins_anew(ridden)


def test_a_lost_leg_starts_where_it_was_while_the_others_run() -> None:
    ridden = walking()
    ridden.stop([3])
    ridden.run(2.0)
    assert ridden.ride.state.lost == (3,)
    assert ridden.sent[-1] == ridden.sent[-20], "the others stand still"
    assert ridden.running.keys() == set(LEGS) - {3}
    ridden.ride.start_again()
    ridden.tick()
    assert ridden.started[-1] == (ridden.now_s, 3)
    assert ridden.ride.error is None
    ridden.run(0.5)
    assert ridden.ride.state.commanded == STILL, "nothing of before is walked on"
    walks(ridden, 0.5)
    assert ridden.posture is Posture.WALKING


def test_a_robot_that_starts_as_a_whole_starts_all_legs_at_once_from_lying_also_after_a_leg_was_stopped() -> None:
    ridden = Ridden(robot=WHOLE)
    ridden.ride.go(AHEAD, ridden.now_s)
    ridden.tick()
    assert sorted(ridden.running) == list(LEGS), "the first setpoint has all six"
    walks(ridden, 6.0)
    assert ridden.posture is Posture.WALKING
    ridden.stop([3])
    ridden.run(0.5)
    assert (ridden.ride.phase, ridden.ride.state.lost) == (Phase.FAILED, ALL)
    expect_begins_anew(ridden)
    assert len({at_s for at_s, _ in ridden.started}) == 1


def test_a_stopped_leg_that_somebody_has_started_again_is_lost_all_the_same() -> None:
    """That it runs again is not this driver's decision, and where it is nobody here knows."""
    ridden = walking()
    assert ridden.ride.stopped(StoppedError("somebody stopped it", (3,)), LEGS) == {1, 2, 4, 5, 6}
    assert ridden.ride.state.lost == (3,)
    expect_begins_anew(ridden)


def test_a_stop_while_the_legs_are_started_starts_no_more_of_them() -> None:
    ridden = Ridden()
    ridden.ride.stand(None, ridden.now_s)
    ridden.until(lambda: len(ridden.running) == 2)
    ridden.stop([1])
    ridden.run(0.2)
    assert [leg for _, leg in ridden.started] == [1, 2]
    assert ridden.ride.phase is Phase.FAILED
    ridden.run(0.3)
    expect_begins_anew(ridden)


@pytest.mark.parametrize("seconds", [1.0, 1.7])
def test_a_stop_while_lost_legs_are_started_leaves_the_others_standing(seconds: float) -> None:
    """Also the one that runs again by then: wherever it was in its stride, its foot is put down."""
    ridden = walking(seconds)
    ridden.stop([2, 5])
    ridden.run(1.0)
    ridden.ride.start_again()
    ridden.tick()
    ridden.stop([4])
    ridden.run(0.5)
    assert ridden.ride.state.lost == (4, 5)
    assert ridden.running.keys() == {1, 2, 3, 6}
    feet_m = [ROBOT.foot_m(leg, angles)[2] for leg, angles in ridden.sent[-1].items()]
    assert feet_m == pytest.approx([feet_m[0]] * 4, abs=1e-4)


def test_words_during_an_error_raise_it_and_start_nothing() -> None:
    ridden = walking()
    ridden.estop()
    ridden.tick()
    ridden.estopped = False
    with pytest.raises(StoppedError):
        ridden.ride.go(AHEAD, ridden.now_s)
    with pytest.raises(StoppedError):
        ridden.ride.stand(None, ridden.now_s)
    with pytest.raises(StoppedError):
        ridden.ride.sit(ridden.now_s)
    ridden.run(0.2)
    assert not ridden.running


class AnyOrder(RuleBasedStateMachine):
    """The gateway of `Ridden` judges each start and each state."""

    @initialize(stands=st.booleans(), robot=st.sampled_from((ROBOT, WHOLE, FED_SINGLY)))
    def begin(self, stands: bool, robot: Robot) -> None:
        self.ridden = standing(robot=robot) if stands else Ridden(robot=robot)

    @rule(ticks=st.integers(1, 30))
    def time_passes(self, ticks: int) -> None:
        self.ridden.run(ticks * TICK_S)

    @rule(ticks=st.integers(1, 30))
    def walk(self, ticks: int) -> None:
        self._try(lambda: walks(self.ridden, ticks * TICK_S))

    @rule()
    def stand(self) -> None:
        self._try(lambda: self.ridden.ride.stand(None, self.ridden.now_s))

    @rule()
    def sit(self) -> None:
        self._try(lambda: self.ridden.ride.sit(self.ridden.now_s))

    @rule(legs=legs, hides=legs)
    def somebody_stops(self, legs: set[int], hides: set[int]) -> None:
        self.ridden.stop(legs, hides)

    @rule()
    def emergency_stop(self) -> None:
        self.ridden.estop()

    @rule()
    def reset(self) -> None:
        self.ridden.estopped = False

    @rule(seconds=st.sampled_from((0.1, 0.3, 0.4, 12.0)), hides=legs)
    def the_program_pauses(self, seconds: float, hides: set[int]) -> None:
        self.ridden.hides = hides
        self.ridden.wait(seconds)

    @rule(cut=st.booleans())
    def link(self, cut: bool) -> None:
        self.ridden.cut = cut

    @rule()
    def start_again(self) -> None:
        self.ridden.ride.start_again()

    @rule()
    def start_again_and_go(self) -> None:
        """As an impatient person does."""
        self.ridden.estopped = self.ridden.cut = False
        self.ridden.ride.start_again()
        self.ridden.tick()
        self._try(lambda: walks(self.ridden, 0.4))

    def _try(self, do: Callable[[], None]) -> None:
        try:
            do()
        except GatewayError:
            assert self.ridden.ride.error is not None


AnyOrder.TestCase.settings = settings(max_examples=25, stateful_step_count=16, deadline=None)
TestAnyOrder = AnyOrder.TestCase
