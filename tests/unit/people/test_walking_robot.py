"""Where feet can be, what limits them, and the ways between postures: literal numbers of the default robot."""

import math
from itertools import pairwise

import pytest

from gateway.errors import WalkError
from gateway.geometry import load
from gateway.geometry.model import BODY_KG, LINKS_KG
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import STILL, BodyPose, Posture
from gateway.people.walking.planning import Planner, balanced, centre_of_mass, lying_deg, margin_m
from gateway.people.walking.robot import LIFT_M, Range, Robot, ranges
from gateway.people.walking.transitions import Bend, Figure, Footsteps, Shift
from schemas.calibration import Calibration, ServoCalibration
from schemas.config import LimitsReport, ServoLimitsReport
from schemas.robot import LEGS

ROBOT = Robot(load())
USUAL = ROBOT.stance(BodyPose(0.154))
POSE = {leg: ROBOT.angles_deg(leg, USUAL.body.seen(foot)) for leg, foot in USUAL.feet.items()}
TRIPOD, OTHER = [1, 4, 5], [2, 3, 6]


# ---- the robot


def test_the_usual_stance_has_femurs_almost_level_and_tibias_almost_upright() -> None:
    assert (ROBOT.usual_m, ROBOT.lying_m) == pytest.approx((0.154, 0.058))
    assert (USUAL.radius_m, USUAL.why) == (0.055, "")
    for leg, (x, y, z) in USUAL.feet.items():
        mount = ROBOT.geometry.leg_mounts[leg]
        assert (x, y, z) == pytest.approx(
            (mount.xyz_m[0] + 0.19 * math.cos(mount.yaw_rad), mount.xyz_m[1] + 0.19 * math.sin(mount.yaw_rad), 0.0),
            abs=1e-4,
        )
        left = (90.0, 129.8, 118.2)
        assert POSE[leg] == pytest.approx(left if leg % 2 else tuple(180 - each for each in left), abs=0.05)
        assert ROBOT.foot_m(leg, POSE[leg]) == pytest.approx((x, y, -0.154))


def test_a_lying_robot_starts_with_its_feet_two_centimetres_up() -> None:
    left, right = (90.0, 169.0, 116.44), (90.0, 11.0, 63.56)
    assert lying_deg(ROBOT) == {
        10 * leg + joint: deg for leg in LEGS for joint, deg in enumerate(left if leg % 2 else right, start=1)
    }
    assert Planner(ROBOT).found({leg: left if leg % 2 else right for leg in LEGS}).body == BodyPose(ROBOT.lying_m)


@pytest.mark.parametrize("height_m", [0.06, 0.154, 0.28, 0.3])
def test_a_foot_reaches_its_whole_disc_on_the_ground_and_lifted(height_m: float) -> None:
    """And not a wider one, if its limits keep the disc small."""
    stance = ROBOT.stance(BodyPose(height_m))

    def reaches(radius_m: float) -> bool:
        try:
            for leg, (x, y, _) in stance.feet.items():
                for step in range(24):
                    across, along = radius_m * math.cos(math.tau * step / 24), radius_m * math.sin(math.tau * step / 24)
                    for up_m in (0.0, LIFT_M):
                        ROBOT.angles_deg(leg, (x + across, y + along, up_m - height_m))
        except WalkError:
            return False
        return True

    assert reaches(stance.radius_m)
    assert reaches(stance.radius_m + 0.002) == (stance.radius_m == 0.055)
    assert (stance.why == "") == (stance.radius_m == 0.055)


@pytest.mark.parametrize(("zero_deg", "joint_deg", "angle_deg"), [(360.0, 5.0, 5.0), (-180.0, -5.0, 175.0)])
def test_an_angle_is_the_same_a_whole_turn_on(zero_deg: float, joint_deg: float, angle_deg: float) -> None:
    """By its zero the servo would stand at 365 or -185 degrees; the joint's limits allow a whole turn."""
    plain = load()
    servo = plain.servos[31].model_copy(update={"zero_deg": zero_deg})
    coxa = plain.chain[0].model_copy(update={"limits_rad": (-math.tau, math.tau)})
    turned = Robot(plain.model_copy(update={"servos": {**plain.servos, 31: servo}, "chain": (coxa, *plain.chain[1:])}))
    angles = turned.angles_deg(3, ROBOT.foot_m(3, (90 + joint_deg, 130.0, 118.0)))
    assert angles == pytest.approx((angle_deg, 130.0, 118.0))


def test_a_servo_keeps_half_a_degree_of_its_range_free_within_discs_and_none_else() -> None:
    first = POSE[1][0]
    for spare_deg, room_deg, fits in ((0.5, 0.6, True), (0.5, 0.4, False), (0.0, 0.1, True)):
        for low, high in ((room_deg, 40.0), (40.0, room_deg)):
            limited = Robot(load(), {11: Range(first - low, first + high)})
            foot_m = USUAL.body.seen(USUAL.feet[1])
            if fits:
                assert limited.angles_deg(1, foot_m, spare_deg) == POSE[1]
            else:
                ends = f"{first - low:g} to {first + high:g}"
                with pytest.raises(WalkError, match=rf"servo 11 would stand at 90\.0 degrees, and may go from {ends}"):
                    limited.angles_deg(1, foot_m, spare_deg)


def test_a_range_is_what_settings_calibration_and_wire_allow() -> None:
    limits = LimitsReport(servos={"11": ServoLimitsReport(min_deg=20, max_deg=170, max_speed_deg_s=60)})
    servos = {
        "11": ServoCalibration(trim_deg=25, min_deg=10, max_deg=160),
        "12": ServoCalibration(trim_deg=-7),
        "13": ServoCalibration(trim_deg=5, inverted=True),
    }
    found = ranges(limits, Calibration(revision=1, landing={}, servos=servos))
    assert found[11] == Range(20, 155, 60)
    assert found[12] == Range(7, 180, 300)
    assert found[13] == Range(5, 180, 300)
    assert found[21] == Range(0, 180, 300)
    assert ranges(limits, None)[11] == Range(20, 170, 60)
    assert len(found) == 18


def test_limits_that_leave_a_servo_no_angle_are_rejected() -> None:
    with pytest.raises(WalkError, match="servo 42: its limits and its joint's leave no angle"):
        Robot(load(), {42: Range(100, 90)})


# ---- balance


def test_the_centre_of_mass_is_that_of_the_body_and_of_each_link() -> None:
    """Leg 1 is stretched out, so that the centre is on no axis of symmetry."""
    pose = {**POSE, 1: (120.0, 90.0, 90.0)}
    mounts = [mount.xyz_m for mount in ROBOT.geometry.leg_mounts.values()]
    parts = [(BODY_KG, [(min(axis) + max(axis)) / 2 for axis in zip(*mounts, strict=True)])]
    for leg, angles in pose.items():
        positions = ROBOT.positions(leg, angles)
        ends = pairwise((*positions.joints_m, positions.foot_m))
        parts += [
            (kg, [(a + b) / 2 for a, b in zip(*link, strict=True)]) for kg, link in zip(LINKS_KG, ends, strict=True)
        ]
    total_kg = sum(kg for kg, _ in parts)
    wanted = [sum(kg * at[axis] for kg, at in parts) / total_kg for axis in range(3)]
    assert total_kg == pytest.approx(2.68)
    assert centre_of_mass(ROBOT, BodyPose(0.2), pose) == pytest.approx([wanted[0], wanted[1], wanted[2] + 0.2])
    leaning = centre_of_mass(ROBOT, BodyPose(0.2, 0.1, 0.0), pose)
    assert leaning[1] == pytest.approx(wanted[1] * math.cos(0.1) - wanted[2] * math.sin(0.1))


def test_a_point_is_as_far_inside_a_polygon_as_the_nearest_side() -> None:
    square = [(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (0.0, 2.0)]
    assert margin_m((1.0, 1.5), square) == pytest.approx(0.5)
    assert margin_m((3.8, 1.0), square) == pytest.approx(0.2)
    assert margin_m((5.0, 1.0), square) == pytest.approx(-1.0)
    assert margin_m((2.0, 1.0), [*square, (2.0, 1.5), (2.0, 0.0)]) == pytest.approx(1.0), (
        "a foot within it, one on a side"
    )
    assert margin_m((0.5, 0.5), square[:2]) == margin_m((0.5, 0.5), [*square[:2], square[0]]) == -math.inf


def test_a_robot_is_balanced_with_a_centimetre_to_spare() -> None:
    figure = Figure(USUAL.body, dict(USUAL.feet), dict(POSE))
    x, y, _ = centre_of_mass(ROBOT, USUAL.body, POSE)
    for spare_m, stands in ((0.0101, True), (0.0099, False)):
        figure.feet |= {1: (x - spare_m, 9.0, 0.0), 4: (x - spare_m, -9.0, 0.0), 5: (9.0, y, 0.0)}
        assert balanced(ROBOT, figure, TRIPOD) == stands


# ---- the ways


def test_a_robot_that_stands_is_found_standing_without_a_move() -> None:
    found = Planner(ROBOT).found(POSE)
    assert (found.sits, found.moves) == (False, ())
    assert found.body == pytest.approx(USUAL.body)
    for leg, foot in found.feet.items():
        assert foot == pytest.approx(USUAL.feet[leg], abs=1e-9)


@pytest.mark.parametrize("legs", [TRIPOD, [1, 2, 3, 4, 5]])
def test_legs_that_do_not_carry_are_folded_three_at_a_time_by_a_robot_that_lies(legs: list[int]) -> None:
    """Whichever other legs are slack."""
    planner = Planner(ROBOT)
    found = planner.found({leg: POSE[leg] for leg in legs})
    lies = planner.found({})
    assert found.sits
    assert found.body == lies.body == BodyPose(ROBOT.lying_m)
    assert [(type(move), [*move.paths], move.then) for move in found.moves if isinstance(move, Bend)] == [
        (Bend, TRIPOD, None),
        (Bend, OTHER, lies.body),
    ]
    for move in found.moves:
        assert isinstance(move, Bend)
        assert move.paths == {leg: (found.pose[leg], lies.pose[leg]) for leg in move.paths}
    for leg, foot in found.feet.items():
        assert foot == pytest.approx(found.body.grounded(ROBOT.foot_m(leg, found.pose[leg])))


def test_a_lying_robot_stands_up_by_lowering_its_feet_rising_and_stepping_to_their_places() -> None:
    planner = Planner(ROBOT)
    lies = planner.found({})
    lowered, rises, *steps = planner.way(lies, USUAL)
    assert isinstance(lowered, Footsteps)
    assert (sorted(lowered.paths), lowered.lift_m, lowered.seconds) == ([*LEGS], 0.0, 0.25)
    assert rises == Shift(lies.body, USUAL.body)
    assert rises.seconds == pytest.approx((0.154 - 0.058) / 0.08)
    assert [(type(step), [*step.paths]) for step in steps if isinstance(step, Footsteps)] == [
        (Footsteps, TRIPOD),
        (Footsteps, OTHER),
    ]
    ends = lies.copy()
    for move in (lowered, rises, *steps):
        move.put(ends, ROBOT, 1.0)
    assert ends.body == USUAL.body
    assert ends.feet == USUAL.feet
    for leg, angles in ends.pose.items():
        assert angles == pytest.approx(POSE[leg])


def test_the_way_down_is_the_way_up_and_ends_in_the_seat() -> None:
    planner = Planner(ROBOT)
    stands = Figure(USUAL.body, dict(USUAL.feet), dict(POSE))
    *steps, sinks = planner.way(stands, None)
    assert [[*step.paths] for step in steps if isinstance(step, Footsteps)] == [TRIPOD, OTHER]
    assert sinks == Shift(USUAL.body, BodyPose(ROBOT.lying_m))


def test_a_stance_that_no_plan_reaches_is_an_error() -> None:
    planner = Planner(ROBOT)
    nowhere = USUAL._replace(feet={leg: (x * 2, y * 2, 0.0) for leg, (x, y, _) in USUAL.feet.items()})
    with pytest.raises(WalkError, match="it finds no way to stand up within its limits"):
        planner.way(planner.found({}), nowhere)


def test_an_engine_rests_until_it_is_asked_and_its_first_angles_are_those_that_it_found() -> None:
    engine = Engine(ROBOT)
    assert engine.posture is Posture.LYING
    assert engine.step(STILL, 0.02) == engine.pose == Planner(ROBOT).found({}).pose
    assert (engine.limit, engine.scaled, engine.commanded) == ("", STILL, STILL)


@pytest.mark.parametrize("height_mm", range(120, 175, 5))
def test_a_robot_found_standing_sits_down_on_all_its_feet(height_mm: int) -> None:
    """Its angles are reported in hundredths of a degree. No leg is bent in the air: that is for feet out of reach."""
    planner, stance = Planner(ROBOT), ROBOT.stance(BodyPose(height_mm / 1000))
    figure = Figure(stance.body, dict(stance.feet), {})
    figure.place(ROBOT, LEGS)
    found = planner.found({leg: (round(a, 2), round(b, 2), round(c, 2)) for leg, (a, b, c) in figure.pose.items()})
    assert not [move for move in planner.way(found, None) if isinstance(move, Bend)]
