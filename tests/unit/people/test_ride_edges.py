"""A ride to the second and to the number: what each silence does at its time and just behind it, and how it begins."""

from typing import Final

import pytest

from gateway.errors import RejectedError, StoppedError
from gateway.people.walking import STILL, Phase, Posture, Ride, RideTask, Silences, Velocity, Wish
from tests.support.ridden import ROBOT, standing

AHEAD: Final = Velocity(0.06)
BEHIND_S: Final = 2**-10
"""A time just behind another one: of numbers that a float holds exactly."""


# ---- how it begins


def test_its_silences_can_be_changed_at_any_time() -> None:
    ridden = standing(Silences(rest_s=8.0))
    ridden.ride.silences = Silences(rest_s=1.0)
    assert ridden.ride.silences == Silences(rest_s=1.0)
    ridden.until(lambda: ridden.posture is Posture.MOVING, 2.0)


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
    ride.look(5.0)
    assert ride.spent == -1
    ride.look(5.0 + BEHIND_S)
    assert ride.spent == 3


def test_a_driver_who_presses_nothing_lets_it_sit_down_behind_the_time_and_not_at_its_end() -> None:
    ride, at_s = standing().ride, 200.0
    ride.wish(Wish(1), at_s)
    ride.silences = Silences(idle_s=4.0)
    ride.look(at_s + 4.0)
    assert ride.detail == ""
    ride.look(at_s + 4.0 + BEHIND_S)
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
    ridden.ride.wish(Wish(5, height_m=9.0), ridden.now_s)
    assert ridden.ride.spent == 5
    assert ridden.ride.detail
    ridden.ride.wish(Wish(6, AHEAD), ridden.now_s)
    assert ridden.ride.detail == ""
    assert ridden.ride.body.height_m == pytest.approx(ROBOT.usual_m)


def test_the_same_impossible_wish_is_refused_at_each_press() -> None:
    ridden = standing()
    for press in (5, 6):
        ridden.ride.wish(Wish(press, height_m=9.0), ridden.now_s)
        assert ridden.ride.spent == press


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


def test_a_leg_that_somebody_else_starts_meanwhile_is_not_the_rides() -> None:
    ridden = standing()
    assert ridden.ride.stopped(StoppedError("leg 1 was stopped", (1,)), (2, 3, 4, 5, 6)) == {2, 3, 4, 5, 6}
    assert ridden.ride.stopped(StoppedError("leg 2 was stopped", (2,)), (1, 3, 4, 5, 6)) == {3, 4, 5, 6}


def phase_of(ride: Ride) -> Phase:
    """Now: a checker of types takes an attribute for what it was."""
    return ride.phase


def fallen(rest_s: float, at_s: float) -> Ride:
    """It stands, and has fallen at this time, right behind a command."""
    ride = standing().ride
    ride.silences = Silences(rest_s=rest_s)
    ride.go(STILL, at_s)
    ride.look(at_s)
    ride._engine.felt = ride._engine.felt._replace(fault="it has fallen")
    return ride


def test_one_that_has_fallen_is_stopped_behind_the_silence_and_not_at_its_end() -> None:
    ride = fallen(rest_s=1.0, at_s=200.0)
    ride.look(201.0)
    assert not ride.over
    ride.look(201.0 + BEHIND_S)
    assert (ride.over, ride.detail) == (True, "it has fallen")


def test_one_that_has_fallen_is_given_up_behind_two_seconds_and_not_at_their_end() -> None:
    ride = fallen(rest_s=8.0, at_s=200.0)
    ride.look(202.0)
    assert phase_of(ride) is Phase.RUNS
    ride.look(202.0 + BEHIND_S)
    assert phase_of(ride) is Phase.FAILED
    assert str(ride.error) == "it has fallen"
