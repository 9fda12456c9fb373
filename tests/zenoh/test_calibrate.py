"""The commands of `calibrate` on a running gateway."""

import re
from pathlib import Path

import pytest

from gateway.client import Client
from schemas.calibration import ServoChange
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A login of its own: what a shell's lease leaves behind."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


gateway = gateway_fixture(patient(10_000))
anna = client_fixture("anna", rests=True)


def test_the_landing_pose_is_where_the_running_servos_stand(gateway: Gateway, anna: Client) -> None:
    nobody = gateway.run("calibrate", "landing")
    assert nobody.returncode == 1
    assert "no servo of the robot runs" in nobody.stdout
    assert anna.start_leg(1, 50, 60, 70).accepted
    assert anna.start_leg(2, 80, 85, 90.25).accepted
    unasked = gateway.run("calibrate", "landing")
    assert (unasked.returncode, unasked.stdout.splitlines()[-1]) == (
        1,
        "nothing is written: this is no terminal, so nobody can be asked; --yes agrees",
    )
    end = gateway.run("calibrate", "landing", "--leg", "2", "--yes")
    assert end.returncode == 0, str(end)
    assert re.search(r"^ +23 +90\.25$", end.stdout, re.MULTILINE)
    landing = anna.calibration().landing
    assert {name: angle for name, angle in landing.items() if name[0] in "12" and name != "13"} == {
        "21": 80,
        "22": 85,
        "23": 90.25,
    }
    assert all(servo.running for servo in anna.state().legs[0].servos), "it stops nobody, and needs no lease for that"


def test_what_was_exported_comes_back_whole(gateway: Gateway, anna: Client, tmp_path: Path) -> None:
    assert anna.calibrate({51: ServoChange(trim_deg=2, inverted=True)}, {51: 30}).accepted
    file = tmp_path / "robot.json"
    file.write_text(gateway.run("calibrate", "export").stdout)
    assert gateway.run("calibrate", "show", "--json").stdout == file.read_text()
    before = anna.calibration()
    assert anna.calibrate(
        {51: ServoChange(trim_deg=0, inverted=False), 52: ServoChange(trim_deg=9)}, {51: None}
    ).accepted
    assert anna.calibrate({}, {52: 20}).accepted
    unasked = gateway.run("calibrate", "import", str(file))
    assert unasked.returncode == 1
    assert "nobody can be asked" in unasked.stdout
    end = gateway.run("calibrate", "import", str(file), "--yes")
    assert end.returncode == 0, str(end)
    after = anna.calibration()
    assert (after.servos, after.landing) == (before.servos, before.landing)
    again = gateway.run("calibrate", "import", str(file), "--yes")
    assert (again.returncode, again.stdout.split(":")[0]) == (0, "there is nothing to change")
