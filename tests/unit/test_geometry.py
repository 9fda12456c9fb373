"""The robot's shape: its file, servo angles and joint angles, where the feet are, and the URDF."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as Xml

import pytest

from gateway.errors import ConfigError
from gateway.geometry import ELKAPOD, foot_m, joint_name, load, transforms, urdf
from gateway.geometry.kinematics import from_rpy, plus, rotated, times
from gateway.geometry.model import MAX_FILE_BYTES
from schemas.robot import LEGS, SERVO_IDS

GEOMETRY: Final = load()
POSES: Final = [
    {},
    {servo_id: 0.1 * index - 0.9 for index, servo_id in enumerate(SERVO_IDS)},
]


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


def test_a_straight_leg_ends_where_its_lengths_add_up_to() -> None:
    for leg in LEGS:
        mount = GEOMETRY.leg_mounts[leg]
        out_m = 0.0676 + 0.09237 + 0.2135
        x, y, z = foot_m(GEOMETRY, leg, {})
        assert x == pytest.approx(mount.xyz_m[0] + out_m * math.cos(mount.yaw_rad), abs=1e-6)
        assert y == pytest.approx(mount.xyz_m[1] + out_m * math.sin(mount.yaw_rad), abs=1e-6)
        assert z == pytest.approx(-0.03 + 0.02428 + 0.0086, abs=1e-6)


@pytest.mark.parametrize("pose", POSES, ids=("zero", "bent"))
def test_the_urdf_stands_as_the_frames_do(pose: dict[int, float]) -> None:
    """Its joints, multiplied as a viewer does, put every link where `transforms` puts it."""
    robot = Xml.fromstring(urdf(GEOMETRY))  # noqa: S314  (our own text)
    placed = {"base": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))}
    for joint in robot.iter("joint"):
        origin, parent, child = joint.find("origin"), joint.find("parent"), joint.find("child")
        assert origin is not None
        assert parent is not None
        assert child is not None
        at_m, turned = placed[parent.attrib["link"]]
        xyz = numbers(origin.attrib["xyz"])
        rotation = times(turned, from_rpy(numbers(origin.attrib["rpy"])))
        if joint.attrib["type"] == "revolute":
            servo_id = int(joint.attrib["name"].removeprefix("joint_"))
            assert joint.attrib["name"] == joint_name(servo_id)
            angle = pose.get(servo_id, 0.0)
            rotation = times(rotation, (0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)))  # about its z
        placed[child.attrib["link"]] = plus(at_m, rotated(turned, xyz)), rotation
    assert {link.attrib["name"] for link in robot.iter("link")} == placed.keys()
    assert len(list(robot.iter("joint"))) == 24

    frames = {"base": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))}
    for step in transforms(GEOMETRY, pose):
        at_m, turned = frames[step.parent]
        frames[step.child] = plus(at_m, rotated(turned, step.translation_m)), times(turned, step.rotation)
    assert frames.keys() == placed.keys()
    for name, (at_m, turned) in frames.items():
        assert placed[name][0] == pytest.approx(at_m, abs=1e-5), name
        assert placed[name][1] == pytest.approx(turned, abs=1e-5), name


def numbers(text: str) -> tuple[float, float, float]:
    x, y, z = map(float, text.split())
    return x, y, z


def changed(change: Callable[[dict[str, Any]], object]) -> str:
    values = json.loads(ELKAPOD.read_text())
    change(values)
    return json.dumps(values)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
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
def test_a_faulty_file_is_told_in_a_sentence_that_names_the_place(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "robot.json"
    path.write_text(text)
    with pytest.raises(ConfigError) as told:
        load(path)
    assert sentence in str(told.value)
    assert all(line.startswith(str(path)) for line in str(told.value).splitlines())


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load(tmp_path / "robot.json")


def test_another_robots_file_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "robot.json"
    path.write_text(changed(lambda it: it["servos"].update({"11": {"zero_deg": 45, "direction": -1}})))
    assert load(path).joint_rad(11, 0) == pytest.approx(math.radians(45))
