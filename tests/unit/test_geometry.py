"""The robot's shape: its file, servo and joint angles, where the feet are; and the legs' inverse kinematics."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.errors import ConfigError, WalkError
from gateway.geometry import ELKAPOD, load
from gateway.geometry.model import MAX_FILE_BYTES
from gateway.people.walking.inverse import Limb
from schemas.robot import LEGS

GEOMETRY: Final = load()


def test_a_servos_angle_and_its_joints_are_as_the_robots_own_software_has_them() -> None:
    """The formulas are the file's `servo_deg_from_joint_rad`."""
    for leg in LEGS:
        for joint_rad in (-1.5, -0.25, 0.0, 0.75):
            deg = math.degrees(joint_rad)
            formulas = deg + 90, deg + 90 if leg % 2 else 180 - (deg + 90), -deg if leg % 2 else 180 + deg
            for number, servo_deg in enumerate(formulas, start=1):
                servo = GEOMETRY.servos[10 * leg + number]
                assert servo.servo_deg(joint_rad) == pytest.approx(servo_deg)
                assert servo.joint_rad(servo_deg) == pytest.approx(joint_rad)


def changed(change: Callable[[dict[str, Any]], object]) -> str:
    values = json.loads(ELKAPOD.read_text())
    change(values)
    return json.dumps(values)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "there is no such file"),
        ("{", "Invalid JSON"),
        ("[" * 100_000, "Invalid JSON"),
        (" " * (MAX_FILE_BYTES + 1), "is larger than"),
        (changed(lambda it: it["servos"].update({"77": it["servos"]["11"]})), "no servo has the id: 77"),
        (changed(lambda it: it["leg_mounts"].pop("6")), "six legs"),
        (changed(lambda it: it["leg_mounts"]["1"].update(xyz_m=[178, 132, -30])), "leg_mounts.1.xyz_m.0"),
        (changed(lambda it: it["chain"][0].update(axis=[0, 0, 0])), "an axis has the length 1"),
        (changed(lambda it: it["servos"]["11"].update(zero_deg=float("nan"))), "servos.11.zero_deg"),
    ],
)
def test_a_faulty_file_is_a_sentence_that_names_the_place(tmp_path: Path, text: str | None, sentence: str) -> None:
    path = tmp_path / "robot.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError) as told:
        load(path)
    assert sentence in str(told.value)
    assert all(line.startswith(str(path)) for line in str(told.value).splitlines())


# ---- inverse: exact wherever a leg reaches, and a sentence where it does not


LIMBS: Final = {leg: Limb(GEOMETRY, leg) for leg in LEGS}
MICROMETRE: Final = 1e-6
joints = st.tuples(*(st.floats(*joint.limits_rad) for joint in GEOMETRY.joints))


@given(leg=st.sampled_from(LEGS), angles=joints)
@settings(max_examples=300)
def test_forward_of_inverse_is_where_the_foot_was_to_be(leg: int, angles: tuple[float, float, float]) -> None:
    """The whole workspace: wherever joint angles within the limits can put a foot."""
    wanted = LIMBS[leg].forward(angles).foot_m
    found = LIMBS[leg].inverse(wanted)
    assert math.dist(LIMBS[leg].forward(found).foot_m, wanted) < MICROMETRE


def leg_3_of(tmp_path: Path, change: Any) -> Limb:
    path = tmp_path / "robot.json"
    path.write_text(changed(change))
    return Limb(load(path), 3)


@pytest.mark.parametrize(
    "change",
    [
        lambda it: it["chain"][2].update(origin_xyz_m=[0.09, 0.03, 0.015], origin_rpy_rad=[3.14159265, 0, 0.4]),
        lambda it: it["chain"][0].update(axis=[0, 0, -1], origin_rpy_rad=[0, 0, 0.3]),
        lambda it: (
            it["chain"][1].update(axis=[0, 1, 0], origin_rpy_rad=[0, 0, 0])
            or it["chain"][2].update(axis=[0, -1, 0], origin_rpy_rad=[0, 0.2, 0])
            or it["chain"][3].update(origin_xyz_m=[0.2, 0.01, -0.05])
        ),
        lambda it: it["chain"][1].update(origin_rpy_rad=[1.56, 0.004, 0]),
    ],
    ids=["turned knee", "downward axis", "axes along y", "crooked"],
)
def test_another_robots_chain_is_inverted_too(tmp_path: Path, change: Any) -> None:
    limb = leg_3_of(tmp_path, change)
    for first in (-0.9, 0.0, 0.7):
        for second in (-0.6, 0.2, 1.0):
            for third in (-2.2, -1.3, -0.5):
                wanted = limb.forward((first, second, third)).foot_m
                assert math.dist(limb.forward(limb.inverse(wanted)).foot_m, wanted) < MICROMETRE


@pytest.mark.parametrize(
    "change",
    [
        lambda it: it["chain"][0].update(axis=[1, 0, 0]),
        lambda it: it["chain"][1].update(origin_rpy_rad=[0, 0, 0]),
        lambda it: it["chain"][2].update(axis=[1, 0, 0]),
    ],
)
def test_a_chain_without_a_closed_form_is_rejected(tmp_path: Path, change: Any) -> None:
    with pytest.raises(WalkError, match="for another chain there is no walking"):
        leg_3_of(tmp_path, change)


def test_what_a_leg_does_not_reach_is_an_error_that_says_how_far_it_reaches() -> None:
    for point in ((1.0, 1.0, -0.1), (0.17841, 0.13276, 0.5)):
        with pytest.raises(WalkError, match=r"leg 1 does not reach: .* and 0\.121 to 0\.306 m are possible"):
            LIMBS[1].inverse(point)
