"""The robot's shape: its file, servo angles and joint angles, where the feet are, and the URDF."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.errors import ConfigError
from gateway.geometry import ELKAPOD, load
from gateway.geometry.model import MAX_FILE_BYTES
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
        (None, "No such file"),
        ("{", "is no JSON"),
        ("[" * 100_000, "is no JSON"),
        ("[]", "the file"),
        (" " * (MAX_FILE_BYTES + 1), "it is no geometry file"),
        (changed(lambda it: it.pop("servos")), "servos: Field required"),
        (changed(lambda it: it["servos"].pop("32")), "missing: 32"),
        (changed(lambda it: it["servos"].update({"77": it["servos"]["11"]})), "no servo has the id: 77"),
        (changed(lambda it: it["leg_mounts"].pop("6")), "six legs"),
        (changed(lambda it: it["leg_mounts"]["1"].update(xyz_m=[178, 132, -30])), "leg_mounts.1.xyz_m.0"),
        (changed(lambda it: it["chain"].pop()), "chain.3"),
        (changed(lambda it: it["chain"][0].update(axis=[0, 0, 0])), "an axis has the length 1"),
        (changed(lambda it: it["servos"]["11"].update(direction=2)), "servos.11.direction"),
        (changed(lambda it: it["servos"]["11"].update(zero_deg=float("nan"))), "servos.11.zero_deg"),
    ],
)
def test_a_faulty_file_is_told_in_a_sentence_that_names_the_place(
    tmp_path: Path, text: str | None, sentence: str
) -> None:
    path = tmp_path / "robot.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError) as told:
        load(path)
    assert sentence in str(told.value)
    assert all(line.startswith(str(path)) for line in str(told.value).splitlines())
