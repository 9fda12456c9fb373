"""A ride to the second and to the number: what each silence does at its time and just behind it, and how it begins."""

from typing import Final

import pytest

from gateway.errors import RejectedError, StoppedError
from gateway.people.walking import STILL, Phase, Posture, Ride, RideTask, Silences, Velocity, Wish
from gateway.people.walking.ride import START_PAUSE_S
from schemas.robot import LEGS
from tests.support.ridden import FED_SINGLY, ROBOT, Ridden, standing

AHEAD: Final = Velocity(0.06)
BEHIND_S: Final = 2**-10
"""A time just behind another one: of numbers that a float holds exactly."""


# ---- how it begins


def test_a_ride_begins_with_no_press_used_and_its_first_press_may_be_0() -> None:
    ride = Ride(ROBOT)
    assert (ride.spent, ride.detail, ride.phase, ride.wants_again) == (-1, "", Phase.RESTS, False)
    ride.wish(Wish(0, AHEAD), 0.0)
    assert ride.phase is Phase.STARTS
    assert ride.state.commanded == AHEAD


def test_it_begins_in_the_posture_of_the_legs_that_run_already() -> None:
    ridden = standing()
    assert Ride(ROBOT, running=ridden.running).posture is not Posture.LYING


def test_legs_that_run_when_the_first_command_is_given_are_held_where_they_are() -> None:
    """No leg that runs moves while others start: somebody may have a hand there."""
    coxa, femur, tibia = standing().running[1]
    angles = coxa + 1, femur, tibia
    ride = Ride(ROBOT)
    ride.go(STILL, 0.0)
    ride.found(ROBOT, {1: angles}, 0.0)
    assert ride.next(0.0).pose[1] == pytest.approx(angles)


def test_a_command_to_one_that_rested_goes_on() -> None:
    ride = Ride(ROBOT, silences=Silences(rest_s=1.0))
    ride.look(2.0)
    assert ride.over
    ride.sit(2.0)
    assert not ride.over
    assert ride.phase is Phase.STARTS


def test_its_silences_can_be_changed_at_any_time() -> None:
    ridden = standing(Silences(rest_s=8.0))
    ridden.ride.silences = Silences(rest_s=1.0)
    assert ridden.ride.silences == Silences(rest_s=1.0)
    ridden.until(lambda: ridden.posture is Posture.MOVING, 2.0)


# ---- the silences


def test_a_press_is_used_up_behind_the_silence_and_not_at_its_end() -> None:
    ride = Ride(ROBOT, silences=Silences(hold_s=1.0, rest_s=8.0))
    ride.wish(Wish(3), 4.0)
    ride.look(5.0)
    assert ride.spent == -1
    ride.look(5.0 + BEHIND_S)
    assert ride.spent == 3


def test_a_ride_at_rest_is_over_behind_the_silence_and_not_at_its_end() -> None:
    ride = Ride(ROBOT, silences=Silences(rest_s=1.0))
    ride.look(1.0)
    assert not ride.over
    ride.look(1.0 + BEHIND_S)
    assert ride.over


def test_a_driver_who_presses_nothing_lets_it_sit_down_behind_the_time_and_not_at_its_end() -> None:
    ride, at_s = standing().ride, 200.0
    ride.wish(Wish(1), at_s)
    ride.silences = Silences(idle_s=4.0)
    ride.look(at_s + 4.0)
    assert ride.detail == ""
    ride.look(at_s + 4.0 + BEHIND_S)
    assert "nothing was pressed for 4 s" in ride.detail


def test_one_that_halted_is_stopped_behind_the_time_and_not_at_its_end() -> None:
    ridden = standing()
    ride, at_s = ridden.ride, 200.0
    ridden.stop([1])
    ridden.until(lambda: ride.phase is Phase.HALTED)
    ride.wish(Wish(ride.spent), at_s)
    ride.silences = Silences(halted_s=4.0)
    ride.look(at_s + 4.0)
    assert not ride.over
    ride.look(at_s + 4.0 + BEHIND_S)
    assert ride.over


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


def test_what_starts_again_stands_and_is_given_the_whole_silence_once_more() -> None:
    ride = Ride(ROBOT, silences=Silences(rest_s=4.0))
    ride.go(AHEAD, 0.0)
    ride.failed(RejectedError("estopped", "engaged"))
    ride.start_again()
    assert ride.next(100.0).do is RideTask.FIND
    ride.found(ROBOT, {}, 100.0)
    assert ride.state.commanded == STILL
    assert ride.phase is Phase.RESTS
    assert ride.next(102.0).look_s == 104.0
    assert not ride.over


def test_one_that_begins_with_legs_that_run_asks_again_who_runs_when_it_starts_again() -> None:
    ridden = Ridden()
    ridden.ride.stand(None, ridden.now_s)
    ridden.until(lambda: ridden.ride.phase is Phase.RUNS)
    ridden.ride.failed(RejectedError("estopped", "engaged"))
    ridden.ride.ended()
    ridden.ride.start_again()
    ridden.ride.found(ROBOT, {}, ridden.now_s)
    ridden.ride.stand(None, ridden.now_s)
    assert ridden.ride.next(ridden.now_s).do is RideTask.FIND


def test_a_leg_that_somebody_else_starts_meanwhile_is_not_the_rides() -> None:
    ridden = standing()
    assert ridden.ride.stopped(StoppedError("leg 1 was stopped", (1,)), (2, 3, 4, 5, 6)) == {2, 3, 4, 5, 6}
    assert ridden.ride.stopped(StoppedError("leg 2 was stopped", (2,)), (1, 3, 4, 5, 6)) == {3, 4, 5, 6}


def test_one_that_halted_for_a_stop_of_no_leg_goes_on_standing_at_the_next() -> None:
    ridden = standing()
    for _ in range(2):
        assert ridden.ride.stopped(StoppedError("somebody stopped it", ()), LEGS) == set(LEGS)
        assert ridden.ride.phase is Phase.HALTED


def test_two_legs_are_started_just_so_long_apart() -> None:
    ride = Ride(ROBOT)
    ride.go(STILL, 0.0)
    ride.found(ROBOT, {}, 0.0)
    started = []
    for now_s in (0.0, START_PAUSE_S - BEHIND_S, START_PAUSE_S):
        pose = ride.next(now_s).pose
        ride.sent(pose)
        started.append(len(pose))
    assert started == [1, 1, 2]


def phase_of(ride: Ride) -> Phase:
    """Now: a checker of types takes an attribute for what it was."""
    return ride.phase


def fallen(rest_s: float, at_s: float) -> Ride:
    """It stands, and has fallen at this time, right behind a command."""
    ride = standing().ride
    ride.silences = Silences(rest_s=rest_s)
    ride.go(STILL, at_s)
    ride.look(at_s)
    ride._walker.engine.felt = ride._walker.engine.felt._replace(fault="it has fallen")
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


def test_a_robot_whose_servos_are_fed_one_after_the_other_stands_up_behind_the_time_and_not_at_its_end() -> None:
    ride = Ride(FED_SINGLY, now_s=-1.0)
    ride.go(STILL, -1.0)
    ride.found(FED_SINGLY, {}, -1.0)
    for number in range(6):
        ride.sent(ride.next((number - 5) / 64).pose)
    ride.look(FED_SINGLY.limp_s)
    assert phase_of(ride) is Phase.STARTS
    ride.look(FED_SINGLY.limp_s + BEHIND_S)
    assert phase_of(ride) is Phase.RUNS


def test_one_that_begins_with_six_legs_that_run_holds_them_before_it_moves_them() -> None:
    running = standing().running
    ride = Ride(ROBOT, running=running)
    ride.found(ROBOT, running, 0.0)
    ride.look(1.0)
    assert phase_of(ride) is Phase.STARTS
    ride.sent(ride.next(1.0).pose)
    assert phase_of(ride) is Phase.RUNS
