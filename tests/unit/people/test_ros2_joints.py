"""What controllers send: joint names in any order, positions of whole legs; and what examples/ros2 configures."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest
from ruamel.yaml import YAML

from gateway.geometry import load
from gateway.people.ros2.joints import JointNames, JointsError, check_reach, legs_deg, of_joints
from schemas.robot import MAX_DEG

GEOMETRY = load()
NAMES = JointNames()
LEG = (11, 12, 13)
REST = (0.0, 0.5, -1.5)

# ---- joints


NO_PATTERNS = ("", "joint", "leg{leg}", "{joint}", "{leg}{joint}{}", "{leg.__class__}{joint}", "a<b")


@pytest.mark.parametrize(
    ("call", "names", "why"),
    [
        (NAMES.servos, (), "names no joint"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_13", "gripper"), "no joint 'gripper'"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_14"), "no joint 'joint_14'"),
        (NAMES.servos, ("joint_11", "joint_12", "joint_13", "joint_12"), "joint_12 twice"),
        (NAMES.servos, ("joint_11", "joint_13"), "of leg 1 it lacks joint_12"),
        (NAMES.servos, ("joint_71",), "no joint 'joint_71'"),
        *((JointNames, each, "no pattern of joint names|gives two joints one name") for each in NO_PATTERNS),
    ],
)
def test_names_and_patterns_that_are_not_taken(call: Callable[[Any], object], names: object, why: str) -> None:
    with pytest.raises(JointsError, match=why):
        call(names)


# ---- positions


@pytest.mark.parametrize(
    ("position", "why"),
    [
        (REST[:2], "there must be one position for each of 3 joints, not 2"),
        ((*REST, 0.0), "there must be one position for each of 3 joints, not 4"),
        *(((0.0, each, -1.5), f"the position of joint_12 is {each}") for each in (math.nan, math.inf, -math.inf)),
    ],
)
def test_a_position_that_is_missing_or_not_finite_is_rejected(position: tuple[float, ...], why: str) -> None:
    with pytest.raises(JointsError, match=why):
        of_joints("position", LEG, position)


@pytest.mark.parametrize("servo_id", LEG)
@pytest.mark.parametrize(("at_deg", "beyond_deg"), [(0.0, -0.01), (MAX_DEG, MAX_DEG + 0.01)])
def test_a_position_is_taken_up_to_the_servos_range_and_never_clamped(
    servo_id: int, at_deg: float, beyond_deg: float
) -> None:
    at = of_joints("position", LEG, REST)
    check_reach(GEOMETRY, at | {servo_id: GEOMETRY.joint_rad(servo_id, at_deg) * (1 - 1e-9)})
    with pytest.raises(JointsError, match=rf"joint_{servo_id} at .* rad is .*° of its servo, which has 0 to 180°"):
        check_reach(GEOMETRY, at | {servo_id: GEOMETRY.joint_rad(servo_id, beyond_deg)})


def test_joints_in_any_order_become_the_degrees_of_their_legs() -> None:
    names = ("joint_63", "joint_12", "joint_61", "joint_13", "joint_62", "joint_11")
    at = of_joints("position", NAMES.servos(names), (-1.5, 0.5, 0.0, -1.5, 0.5, 0.0))
    degrees = legs_deg(GEOMETRY, at)
    assert degrees.keys() == {1, 6}
    assert degrees[1] == pytest.approx([GEOMETRY.servos[name].servo_deg(at[name]) for name in LEG])


# ---- what examples/ros2 configures


FOLDER: Final = Path(__file__).parents[3] / "examples/ros2"
"""Priorities and seconds, as elkapod_core has them."""


def test_what_twist_mux_publishes_is_what_the_bridge_takes() -> None:
    """By DDS a topic has one type: cmd_vel is a Twist."""
    found = YAML(typ="safe").load(FOLDER / "twist_mux.yaml")
    assert found.keys() == {"twist_mux"}
    assert found["twist_mux"]["ros__parameters"]["use_stamped"] is False
    assert "-r cmd_vel_out:=/hexapod/cmd_vel" in (FOLDER / "twist_mux.yaml").read_text()
