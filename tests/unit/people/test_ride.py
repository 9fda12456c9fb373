"""A ride in virtual time: its silences, presses and starts, each by the clock alone. None goes on by itself."""

from collections.abc import Callable
from functools import partial
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from gateway.errors import GatewayError, RejectedError, StoppedError, WalkError
from gateway.people.commands.walk import screen
from gateway.people.console.pages.page_walk import SILENCES as PAGE
from gateway.people.walking.gait_speed import HALT_S
from gateway.people.walking.motion import STILL, Posture, Velocity
from gateway.people.walking.ride import GIVES_UP_S, USUAL_SILENCES, Phase, Ride, RideTask, Silences, Wish
from gateway.people.walking.robot import FEED_S, Robot
from schemas.robot import LEGS
from schemas.telemetry import Telemetry
from tests.support.published import MEASURED
from tests.support.ridden import FED_SINGLY, ROBOT, WHOLE, Ridden, standing
from tests.support.walked import TICK_S

AHEAD: Final = Velocity(0.06)
LONGEST_STRIDE_S: Final = 1.0
SITS_WITHIN_S: Final = 3.0


def moved(ridden: Ridden, before: int) -> bool:
    """Return whether anything but the same pose has been sent since."""
    return any(pose != ridden.sent[before - 1] for pose in ridden.sent[before:])


# ---- a program


@pytest.mark.parametrize("silences", [USUAL_SILENCES, Silences(hold_s=1.0, rest_s=3.0)], ids=["usual", "set"])
def test_a_program_that_falls_silent_stands_then_sits_then_is_stopped(silences: Silences) -> None:
    """Each within a tick of its time: what is longer heats the servos, what is shorter stops a program that pauses."""
    ridden = standing(silences)
    ridden.ride.go(AHEAD, ridden.now_s)
    said_s = ridden.now_s
    ridden.until(lambda: ridden.ride.state.commanded == STILL)
    assert ridden.now_s - said_s == pytest.approx(silences.hold_s, abs=1.5 * TICK_S)
    ridden.until(lambda: ridden.posture is Posture.STANDING, LONGEST_STRIDE_S)
    ridden.until(lambda: ridden.posture is Posture.MOVING, silences.rest_s + 1)
    assert ridden.now_s - said_s == pytest.approx(silences.rest_s, abs=1.5 * TICK_S)
    ridden.until(lambda: ridden.posture is Posture.SITTING, SITS_WITHIN_S)
    sat = len(ridden.sent)
    ridden.until(lambda: ridden.ride.over, silences.rest_s + TICK_S)
    assert not moved(ridden, sat)
    ridden.tick()
    assert not ridden.running
    assert (ridden.ride.phase, ridden.posture) == (Phase.RESTS, Posture.SITTING)


def test_a_way_to_a_posture_is_no_silence_however_long_it_takes() -> None:
    ridden = standing(Silences(rest_s=1.0))
    assert ridden.now_s - 100.0 > 1.5, "it stood up for longer than it may rest"
    ridden.run(0.9)
    assert ridden.posture is Posture.STANDING


def test_legs_that_another_left_standing_are_held_at_once_and_sit_in_silence() -> None:
    """Their watchdog does not wait for a word. Those that were stopped meanwhile are not started."""
    pose = dict(standing().running)
    taken = Ridden(Silences(rest_s=1.0), running=pose)
    taken.tick()
    assert taken.sent == [pose]
    taken.until(lambda: taken.ride.over, 2 * (1.0 + SITS_WITHIN_S))
    gone = Ridden(running=pose)
    gone.stop()
    gone.run(0.5)
    assert (gone.sent, gone.posture) == ([], Posture.LYING)


# ---- a page


class Pad:
    """A page: wishes 25 times a second, until it is frozen."""

    def __init__(self) -> None:
        self.ridden = Ridden(PAGE, once=True)
        self.press = 0
        self.hold()

    def hold(self, velocity: Velocity = STILL) -> None:
        """Begin a new press."""
        self.press += 1
        self.wanted = Wish(self.press, velocity)

    def run(self, seconds: float, *, wishes: bool = True) -> None:
        for tick in range(round(seconds / TICK_S)):
            if wishes and tick % 2 == 0:
                self.ridden.ride.wish(self.wanted, self.ridden.now_s)
            self.ridden.tick()

    def until(self, posture: Posture, at_most_s: float = 6.0) -> None:
        begun_s = self.ridden.now_s
        while self.ridden.posture is not posture:
            assert self.ridden.now_s - begun_s < at_most_s, self.ridden.posture
            self.run(2 * TICK_S)

    @property
    def waits(self) -> bool:
        return self.press <= self.ridden.ride.spent


def held() -> Pad:
    """Return a page whose robot walks."""
    pad = Pad()
    pad.until(Posture.STANDING)
    pad.hold(AHEAD)
    pad.until(Posture.WALKING)
    return pad


def test_each_driver_has_the_silences_that_its_docs_state() -> None:
    assert (PAGE.hold_s, PAGE.rest_s, PAGE.idle_s, PAGE.halted_s) == (0.25, 5.0, 60.0, 5.25)
    assert (USUAL_SILENCES.hold_s, USUAL_SILENCES.rest_s) == (0.5, 10.0)
    assert (screen.KEYS_HOLD_S, screen.KEYS_REST_S) == (0.25, 60.0)


def test_a_page_that_falls_silent_stands_then_sits_and_its_last_wish_is_not_repeated() -> None:
    pad = held()
    ridden, silent_s = pad.ridden, pad.ridden.now_s
    pad.run(0.18, wishes=False)  # the newest came up to 0.04 s before
    assert not pad.waits
    assert ridden.ride.state.commanded == AHEAD
    pad.run(0.12, wishes=False)
    assert pad.waits
    assert ridden.ride.state.commanded == STILL
    ridden.until(lambda: ridden.posture is Posture.STANDING, LONGEST_STRIDE_S)
    ridden.until(lambda: ridden.posture is Posture.MOVING)
    assert ridden.now_s - silent_s == pytest.approx(5.0, abs=0.1)
    ridden.until(lambda: ridden.ride.over, SITS_WITHIN_S)
    ridden.tick()
    assert not ridden.running
    pad.run(1.0)
    assert not ridden.running, "it wakes, with the thumb still on it"


@pytest.mark.lengthy
@given(after_s=st.floats(0.26, 6.5))
@settings(max_examples=12, deadline=None)
def test_a_page_that_wakes_goes_on_with_a_new_press_only(after_s: float) -> None:
    """However long it was silent: nothing walks by the press of before, and it stands on while it is heard."""
    pad = held()
    pad.run(after_s, wishes=False)
    before = pad.ridden.posture
    for _ in range(50):
        pad.run(2 * TICK_S)
        assert pad.waits
        assert pad.ridden.ride.state.commanded == STILL
        assert pad.ridden.ride.over or before is Posture.MOVING or pad.ridden.posture is not Posture.MOVING
    if not pad.ridden.ride.over:
        pad.hold(AHEAD)
        pad.until(Posture.WALKING)


def test_who_leaves_sits_down_and_no_press_changes_that() -> None:
    pad = held()
    pad.ridden.ride.leave(pad.ridden.now_s)
    for _ in range(5):
        pad.hold(AHEAD)
        pad.ridden.ride.leave(pad.ridden.now_s)
        pad.run(0.8)
        assert pad.ridden.ride.state.commanded == STILL
    assert pad.ridden.ride.over
    assert pad.ridden.posture is Posture.SITTING


def test_after_a_lost_leg_only_a_new_press_goes_on_and_after_an_emergency_stop_it_is_over() -> None:
    pad = held()
    pad.ridden.stop([3])
    pad.run(1.0)
    assert pad.ridden.posture is Posture.HALTED
    assert pad.waits
    assert pad.ridden.ride.state.lost == (3,)
    assert pad.ridden.ride.detail == "somebody stopped it"
    pad.hold(AHEAD)
    pad.until(Posture.WALKING)
    pad.ridden.estop()
    pad.run(0.1)
    assert pad.ridden.ride.over
    pad.ridden.estopped = False
    for _ in range(2):
        pad.hold(AHEAD)  # the console begins another ride by it
        pad.run(0.3)
    assert not pad.ridden.running


def test_a_lost_leg_and_a_page_that_is_gone_are_stopped_as_they_stand() -> None:
    pad = held()
    pad.ridden.stop([3])
    pad.ridden.tick()
    assert pad.ridden.until(lambda: pad.ridden.ride.over) == pytest.approx(5.25, abs=0.1)
    pad.ridden.tick()
    assert not pad.ridden.running


# ---- a robot that cannot sit


def test_a_robot_that_has_fallen_is_left_to_the_gateways_watchdog_although_its_driver_goes_on() -> None:
    ridden = Ridden(terrain="adapt")
    for _ in range(300):
        ridden.ride.go(AHEAD, ridden.now_s)
        ridden.tick()
    ridden.telemetry = Telemetry(time=MEASURED.time, age_ms=1.0, tilt_deg=80.0)
    fell_s, fell = ridden.now_s, len(ridden.sent)
    while ridden.ride.phase is Phase.RUNS:
        ridden.ride.go(AHEAD, ridden.now_s)
        ridden.tick()
    assert GIVES_UP_S < ridden.now_s - fell_s < GIVES_UP_S + 0.4
    assert not moved(ridden, fell + 15)
    assert ridden.ride.phase is Phase.FAILED
    ride, now_s = ridden.ride, ridden.now_s
    for word in (partial(ride.go, AHEAD, now_s), partial(ride.stand, None, now_s), partial(ride.sit, now_s)):
        with pytest.raises(WalkError, match="the body leans by 80 degrees: it has fallen"):
            word()
    sent = len(ridden.sent)
    ridden.run(1.0)
    assert len(ridden.sent) == sent


# ---- a power board that feeds one servo after another


def test_nothing_moves_before_the_board_has_fed_the_last_servo() -> None:
    """One that was not fed yet would jump to where the walk is by then."""
    ridden = Ridden(robot=FED_SINGLY)
    ridden.ride.stand(None, ridden.now_s)
    ridden.until(lambda: ridden.running.keys() == set(LEGS))
    last_s, first = ridden.now_s, len(ridden.sent)
    ridden.until(lambda: moved(ridden, first), 3 * FEED_S)
    assert ridden.now_s - last_s == pytest.approx(FEED_S, abs=3 * TICK_S)
    ridden.until(lambda: ridden.posture is Posture.STANDING)


# ---- to the second and to the number: what each silence does at its time and just behind it


BEHIND_S: Final = 2**-10
"""A time just behind another one: of numbers that a float holds exactly."""


def test_a_servo_that_is_still_on_its_way_to_where_it_starts_keeps_the_robot_from_standing_up() -> None:
    ride = Ride(ROBOT)
    ride.stand(None, 0.0)
    assert ride.next(0.0).do is RideTask.FIND
    ride.found(ROBOT, {}, 0.0)
    for tick in range(1, 60):
        step = ride.next(tick / 50)
        assert step.do is RideTask.SEND
        ride.sent(step.pose, arrived=False)
    assert (len(step.pose), ride.phase) == (6, Phase.STARTS)
    ride.sent(step.pose)
    assert ride.phase is Phase.RUNS


# ---- the silences


def test_a_press_is_used_up_behind_the_silence_and_not_at_its_end() -> None:
    ride = Ride(ROBOT, silences=Silences(hold_s=1.0, rest_s=8.0))
    ride.wish(Wish(3), 4.0)
    ride.apply_silences(5.0)
    assert ride.spent == -1
    ride.apply_silences(5.0 + BEHIND_S)
    assert ride.spent == 3


def test_a_driver_who_presses_nothing_lets_it_sit_down_behind_the_time_and_not_at_its_end() -> None:
    ride, at_s = standing().ride, 200.0
    ride.wish(Wish(1), at_s)
    ride.silences = Silences(idle_s=4.0)
    ride.apply_silences(at_s + 4.0)
    assert ride.detail == ""
    ride.apply_silences(at_s + 4.0 + BEHIND_S)
    assert "nothing was pressed for 4 s" in ride.detail


# ---- wishes


def test_a_wish_changes_what_differs_from_the_wish_before_and_nothing_else() -> None:
    ridden = standing()
    ride = ridden.ride
    ride.wish(Wish(1, gait="wave"), ridden.now_s)
    ridden.run(1.0)
    assert ride.state.gait == "wave"
    ride.wish(Wish(2, gait="wave", height_m=0.18), ridden.now_s)
    ridden.run(1.0)
    assert ride.body.height_m == pytest.approx(0.18), ride.detail
    ride.walk_as("ripple", ridden.now_s)
    ridden.run(1.0)
    ride.wish(Wish(3, gait="wave", height_m=0.18), ridden.now_s)
    ridden.run(1.0)
    assert ride.state.gait == "ripple", "what another part of the program has changed stays"


def test_a_wish_for_what_the_legs_cannot_do_uses_its_press_up_and_says_why() -> None:
    ridden = standing()
    for press in (4, 5):
        ridden.ride.wish(Wish(press, height_m=9.0), ridden.now_s)
        assert ridden.ride.spent == press
        assert ridden.ride.detail
    ridden.ride.wish(Wish(6, AHEAD), ridden.now_s)
    assert ridden.ride.detail == ""
    assert ridden.ride.body.height_m == pytest.approx(ROBOT.usual_m)


def test_a_driver_who_sits_down_has_ended_the_ride_and_a_program_has_not() -> None:
    """A program may stand up again from there without another start of its legs."""
    driven, programmed = standing(), standing()
    driven.ride.wish(Wish(0), driven.now_s)
    driven.ride.wish(Wish(0, sits=True), driven.now_s)
    programmed.ride.sit(programmed.now_s)
    driven.run(4.0)
    programmed.until(lambda: programmed.posture is Posture.SITTING)
    programmed.run(0.1)
    assert (driven.ride.over, programmed.ride.over) == (True, False)


# ---- again


def test_where_starting_again_failed_the_press_is_used_up_and_the_reason_is_said() -> None:
    ride = Ride(ROBOT)
    ride.wish(Wish(2), 0.0)
    ride.failed(RejectedError("estopped", "engaged"))
    ride.wish(Wish(3), 1.0)
    assert ride.wants_again
    ride.not_again(RejectedError("estopped", "still engaged"))
    assert (ride.wants_again, ride.spent, ride.detail) == (False, 3, "rejected: estopped: still engaged")


@pytest.mark.parametrize(("rest_s", "after_s", "ends"), [(1.0, 1.0, Phase.ENDS), (8.0, 2.0, Phase.FAILED)])
def test_a_fallen_robot_is_stopped_after_the_silence_and_given_up_after_two_seconds(
    rest_s: float, after_s: float, ends: Phase
) -> None:
    """And not at their end; it has fallen right behind a command."""
    ride = standing(Silences(rest_s=rest_s)).ride
    ride.go(STILL, 200.0)
    ride.apply_silences(200.0)
    ride._engine.felt = ride._engine.felt._replace(fault="it has fallen")
    ride.apply_silences(200.0 + after_s)
    assert (ride.phase, ride.over) == (Phase.RUNS, False)
    ride.apply_silences(200.0 + after_s + BEHIND_S)
    assert (ride.phase, ride.over) == (ends, ends is Phase.ENDS)
    assert str(ride.error or ride.detail) == "it has fallen"


# ---- starting again after any Stops, silences and resets: no leg leaps, and what lies is not said to stand


FASTER: Final = Velocity(0.1)
ALL: Final = tuple(LEGS)
legs = st.sets(st.sampled_from(LEGS), min_size=1)


def walking(seconds: float = 1.0) -> Ridden:
    ridden = standing()
    walks(ridden, seconds)
    return ridden


def walks(ridden: Ridden, seconds: float) -> None:
    for _ in range(round(seconds / TICK_S)):
        ridden.ride.go(FASTER, ridden.now_s)
        ridden.tick()


def expect_begins_anew(ridden: Ridden) -> None:
    """Check that `start_again` alone sends nothing, and that all six then start from lying, one after the other."""
    ridden.ride.start_again()
    sent = len(ridden.sent)
    ridden.run(0.2)
    assert ridden.ride.error is None
    assert (ridden.ride.phase, ridden.posture, len(ridden.sent)) == (Phase.RESTS, Posture.LYING, sent)
    assert not ridden.running
    ridden.started.clear()
    ridden.ride.go(FASTER, ridden.now_s)
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


def test_a_robot_that_starts_as_a_whole_starts_all_legs_at_once_from_lying_also_after_a_leg_was_stopped() -> None:
    ridden = Ridden(robot=WHOLE)
    ridden.ride.go(FASTER, ridden.now_s)
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
    assert ridden.ride.stopped(StoppedError("somebody stopped it", (3,))) == {1, 2, 4, 5, 6}
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


@pytest.mark.parametrize("seconds", [1.0, 1.4, 1.7, 2.1])
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
    still = len(ridden.sent)
    ridden.run(1.0)
    assert not moved(ridden, still)


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

    @rule(sits=st.booleans())
    def stand_or_sit(self, sits: bool) -> None:
        ride, now_s = self.ridden.ride, self.ridden.now_s
        self._try(lambda: ride.sit(now_s) if sits else ride.stand(None, now_s))

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
        """Start again and walk at once, as an impatient person does."""
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


# ---- a wish that a picture bars


def test_a_barred_wish_stands_and_only_a_new_press_goes_on_while_stand_and_sit_do_not_depend_on_it() -> None:
    ridden = standing(PAGE)
    ride, why = ridden.ride, "the picture was 0.7 s old"

    def holds(seconds: float, wish: Wish) -> None:
        for _ in range(round(seconds / TICK_S)):
            ride.wish(wish, ridden.now_s)
            ridden.tick()

    holds(1.0, Wish(1, AHEAD))
    assert ridden.posture is Posture.WALKING
    holds(HALT_S + 2 * TICK_S, Wish(1, AHEAD, barred=why))
    assert (ride.state.commanded, ride.detail, ride.spent) == (STILL, why, 1)
    assert ride.state.posture is Posture.STANDING, "at once, not with the step's end"
    stood = len(ridden.sent)
    holds(2.0, Wish(1, AHEAD))
    assert (ridden.posture, ride.detail) == (Posture.STANDING, why)
    assert not moved(ridden, stood)
    holds(1.0, Wish(2, height_m=0.13, barred=why))
    assert ride.detail == ""
    assert ride.body.height_m == pytest.approx(0.13)
    holds(1.0, Wish(3, AHEAD, height_m=0.13))
    holds(3.0, Wish(4, AHEAD, sits=True, barred=why))
    assert ridden.ride.over
    assert not ridden.running
