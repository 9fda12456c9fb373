"""A trajectory's end and its sender's, in virtual time: what was still to come is not followed; the robot sits down."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import pytest

from gateway.errors import WalkError
from gateway.geometry import load
from gateway.people.ros2.motions import Course
from gateway.people.ros2.trajectory import Trajectory, Waypoint
from gateway.people.walking.ride import REST_S, Ride
from gateway.people.walking.robot import Pose
from schemas.robot import LEGS
from tests.support.ridden import FED_SINGLY, ROBOT, TICK_S, standing

GEOMETRY: Final = load()
STOOD: Final[Pose] = dict(standing().running)
SITS_WITHIN_S: Final = 4.0


def rad(pose: Pose) -> dict[int, float]:
    return {
        10 * leg + joint: GEOMETRY.joint_rad(10 * leg + joint, angle)
        for leg, angles in pose.items()
        for joint, angle in enumerate(angles, start=1)
    }


def plan(begins_s: float, *points: tuple[float, float], legs: tuple[int, ...] = tuple(LEGS)) -> Trajectory:
    """At these seconds the first joint of leg 1 is so many radians from where it stands."""
    still = rad({leg: STOOD[leg] for leg in legs})
    found = [Waypoint(at_s, {**still, 11: still[11] + moved_rad}) for at_s, moved_rad in points]
    return Trajectory(tuple(found), begins_s)


@dataclass
class Followed:
    """A course, and the shell's turns."""

    course: Course = field(default_factory=lambda: Course(ROBOT, lambda pose: Ride(ROBOT, running=pose)))
    now_s: float = 0.0
    sent: list[Pose] = field(default_factory=list)
    over_s: float = math.inf

    def run(self, seconds: float) -> "Followed":
        end_s = self.now_s + seconds
        while self.now_s < end_s and self.over_s == math.inf:
            self.now_s += TICK_S
            pose = self.course.next(self.now_s)
            if pose is None:
                self.over_s = self.now_s
            else:
                self.course.sent(pose)
                self.sent.append(pose)
        return self

    @property
    def first_deg(self) -> float:
        """Of leg 1, as sent last."""
        return self.sent[-1][1][0]

    @property
    def sinks(self) -> bool:
        """Whether it is on its way down, or is."""
        return self.sent[-1][3] != pytest.approx(STOOD[3], abs=0.01)


def followed(*points: tuple[float, float]) -> Followed:
    begun = Followed()
    begun.course.follow(plan(0.0, *points), 0.0)
    return begun


@pytest.mark.parametrize("ends", [Course.lose_sender, Course.leave])
def test_a_sender_that_is_lost_or_leaves_has_it_sit_down_at_once_and_the_rest_of_its_plan_is_not_followed(
    ends: Callable[[Course, float], None],
) -> None:
    one = followed((0.5, 0.0), (50.0, 1.0)).run(1.0)
    here = one.first_deg
    ends(one.course, one.now_s)
    one.run(SITS_WITHIN_S)
    assert one.sinks
    assert one.over_s < 1.0 + SITS_WITHIN_S
    assert max(abs(pose[1][0] - here) for pose in one.sent[50:60]) < 5, "it goes on from where it was"


def test_a_sender_that_is_lost_behind_its_plans_end_changes_nothing() -> None:
    one = followed((0.5, 0.0)).run(1.0)
    one.course.lose_sender(one.now_s)
    one.run(9.4)
    assert not one.sinks


@pytest.mark.parametrize(("legs", "seconds"), [((1, 2), 1.0), (tuple(LEGS), 0.06)], ids=["two", "six, three started"])
def test_with_a_leg_that_does_not_run_nothing_can_sit_and_all_is_stopped(legs: tuple[int, ...], seconds: float) -> None:
    one = Followed()
    one.course.follow(plan(0.0, (30.0, 0.1), legs=legs), 0.0)
    one.run(seconds)
    one.course.lose_sender(one.now_s)
    one.run(0.1)
    assert one.over_s == pytest.approx(seconds + TICK_S)


def test_a_robot_that_can_not_sit_is_stopped() -> None:
    def cannot(_: Pose) -> Ride:
        raise WalkError("it cannot sit")

    one = Followed(Course(ROBOT, cannot))
    one.course.follow(plan(0.0, (30.0, 0.1)), 0.0)
    one.run(1.0)
    one.course.leave(one.now_s)
    assert one.run(0.1).over_s == pytest.approx(1.0 + TICK_S)


# ---- as the action has it


def test_what_is_held_early_keeps_the_legs_that_have_started_or_are_being_started_and_starts_no_other() -> None:
    one = Followed()
    one.course.follow(way := plan(0.0, (1.0, 0.0), (9.0, 0.2)), 0.0)
    one.run(2 * TICK_S)
    pose = one.course.next(3 * TICK_S)
    assert pose is not None
    one.course.hold(way, 3 * TICK_S)
    one.course.sent(pose)
    assert {tuple(pose) for pose in one.run(1.0).sent[2:]} == {(1, 2, 3)}


def test_a_plan_for_some_legs_starts_none_of_the_one_before() -> None:
    one = Followed()
    one.course.follow(plan(0.0, (9.0, 0.2)), 0.0)
    one.run(2 * TICK_S)
    one.course.follow(plan(one.now_s, (9.0, 0.1), legs=(1, 2)), one.now_s)
    assert {tuple(pose) for pose in one.run(1.0).sent[2:]} == {(1, 2)}


def test_a_plan_that_is_not_followed_is_not_held() -> None:
    one = followed((1.0, 0.0), (2.0, 0.2)).run(0.2)
    other = plan(0.0, (1.0, 0.0))
    one.course.hold(other, one.now_s)
    assert one.course.progress(other, one.now_s).ended == "a newer trajectory has replaced it"
    one.run(1.8)
    assert one.first_deg == pytest.approx(GEOMETRY.servos[11].servo_deg(rad(STOOD)[11] + 0.2), abs=0.1)


def test_a_plan_waits_until_the_last_servo_that_it_starts_has_its_supply() -> None:
    """As a walk does: whatever moves before that is one leap, once the supply comes."""
    fed = Followed(Course(FED_SINGLY, lambda pose: Ride(FED_SINGLY, running=pose)))
    fed.course.follow(waiting := plan(0.0, (0.2, 0.0), (1.2, 0.2)), 0.0)
    last_start_s = len(LEGS) * TICK_S
    fed.run(last_start_s + FED_SINGLY.limp_s - TICK_S)
    assert [len(pose) for pose in fed.sent[:7]] == [1, 2, 3, 4, 5, 6, 6]
    assert {pose[1] for pose in fed.sent} == {fed.sent[0][1]}, "nothing moves"
    assert fed.course.progress(waiting, fed.now_s).desired_rad == pytest.approx(rad(fed.sent[-1]))
    fed.run(0.8)
    half = GEOMETRY.servos[11].servo_deg(rad(STOOD)[11] + 0.1)
    assert fed.first_deg == pytest.approx(half, abs=1.5)
    fed.run(0.5)
    there = GEOMETRY.servos[11].servo_deg(rad(STOOD)[11] + 0.2)
    assert fed.first_deg == pytest.approx(there)
    fed.run(REST_S - 0.3)
    assert not fed.sinks, "its last point is held for as long as without the pause"
    fed.course.follow(plan(fed.now_s, (0.5, 0.2), (1.0, 0.3)), fed.now_s)
    fed.run(1.1)
    assert fed.first_deg > there, "what runs has its supply: a further plan begins at once"
