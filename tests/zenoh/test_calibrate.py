"""`calibrate` on a running gateway: the guide from the first key to the wire, and what it does without a screen."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.errors import ConfigError
from gateway.people.tools.attended import calibrate
from gateway.robot.core.calibration import ServoCalibration, calibration_of
from schemas.calibration import ServoChange
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway
from tests.support.heard import frames, states
from tests.support.tmux import Terminal, at_terminal


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gateway]:
    kept = tmp_path_factory.mktemp("kept") / "calibration.toml"
    settings = patient(10_000, watchdog={"repeats": 0}, telemetry={"frames": True}, calibration={"path": str(kept)})
    with Gateway(tmp_path_factory.mktemp("gateway"), settings) as running:
        yield running


@pytest.fixture(autouse=True)
def runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A login of its own: what a shell's lease leaves behind."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path


@pytest.fixture
def anna(gateway: Gateway) -> Iterator[Client]:
    with gateway.client(source="anna") as client:
        client.stop()
        yield client


@contextmanager
def guided(folder: Path, gateway: Gateway) -> Iterator[Terminal]:
    with at_terminal(folder, "calibrate", gateway.endpoint) as terminal:
        terminal.wait("Servo: _", "you drive")
        yield terminal


def start(terminal: Terminal, servo_id: int) -> None:
    terminal.press(*str(servo_id), "Enter")
    terminal.wait(f"Servo {servo_id} goes there AT ONCE")
    terminal.press("Enter")
    terminal.wait(f"servo {servo_id} RUNS at")


# ---- the guide


def test_what_a_person_sees_on_the_robot_reaches_its_disk_and_its_wire(
    gateway: Gateway, anna: Client, tmp_path: Path
) -> None:
    heard = frames(anna)
    with guided(tmp_path, gateway) as terminal:
        start(terminal, 32)
        heard.wait(lambda record: record.bytes == "060220015a00")  # start, 90 degrees
        for angle_deg in (91, 92):
            terminal.press("Right")
            terminal.wait(f"servo 32 RUNS at {angle_deg}°")
        terminal.press("=", "9", "0")
        terminal.wait("it now stands at: 90_")
        terminal.press("Enter")
        terminal.wait("trim +2°", "RUNS at 90°")
        terminal.press("i")
        terminal.wait("turned round", "*+2° inv")
        terminal.press("Escape")
        terminal.wait("servo 32 is stopped")
        assert anna.calibration().revision == 0, "nothing is written before it is confirmed"
        terminal.press("w")
        terminal.wait("Write the calibration of servo 32?")
        terminal.press("y")
        terminal.wait("written: revision 1")
        assert calibration_of(anna.calibration()).servos == {32: ServoCalibration(2_00, inverted=True)}
        start(terminal, 32)
        assert anna.calibrate({31: ServoChange(trim_deg=1)}).reason == "not_holder"
        terminal.press("q")
        terminal.wait("servo 32 is stopped")
        terminal.press("q")
        assert terminal.wait_for_end() == 0
        terminal.wait("revision 1 is in force")
    assert states(anna).wait(lambda state: state.lease.holder is None).calibration.kept
    assert anna.servo(32, "start", 80).accepted
    heard.wait(lambda record: record.bytes == "060220016600")  # its own 102 degrees


def test_what_somebody_else_wrote_while_the_lease_was_lost(gateway: Gateway, anna: Client, tmp_path: Path) -> None:
    with guided(tmp_path, gateway) as terminal:
        start(terminal, 41)
        terminal.press("i")
        terminal.wait("turned round")
        with anna.lease(take=True):
            terminal.wait("THE LEASE IS LOST, and the servo is stopped", "anna holds it now", "you do not drive")
            assert anna.calibrate({42: ServoChange(trim_deg=3)}).accepted
            terminal.press("w")
            terminal.wait("Write the calibration of servo 41?")
            terminal.press("y")
            terminal.wait("lease_held", "anna")
        terminal.press("w")
        terminal.wait("Write the calibration of servo 41?")
        terminal.press("y")
        terminal.wait("NOT DONE: somebody else has changed", "Your changes of servo 41 stand on it now", " +3° ")
        terminal.press("w")
        terminal.wait("Write the calibration of servo 41?")
        terminal.press("y")
        terminal.wait("written: revision")
        found = calibration_of(anna.calibration())
        assert (found.of(41).inverted, found.of(42).trim_cdeg) == (True, 3_00)


def test_it_begins_at_rest_and_with_the_lease(gateway: Gateway, anna: Client, tmp_path: Path) -> None:
    for name, words in (("moves", "a servo runs; stop it first"), ("driven", "rejected: lease_held")):
        folder = tmp_path / name
        folder.mkdir()
        with anna.lease():
            assert anna.stop().accepted
            assert name == "driven" or anna.start_leg(1, 90, 90, 90).accepted
            with at_terminal(folder, "calibrate", gateway.endpoint) as terminal:
                assert terminal.wait_for_end() == 1
                assert words in terminal.words


# ---- without a screen


def test_the_table_goes_through_a_pipe(gateway: Gateway, anna: Client) -> None:
    assert anna.calibrate({13: ServoChange(trim_deg=-3.5, inverted=True, min_deg=20)}, {13: 45.5}).accepted
    end = gateway.run("calibrate", "--show")
    assert end.returncode == 0
    lines = end.stdout.splitlines()
    assert len(lines) == 19
    assert lines[0].split() == ["servo", "trim", "direction", "lowest", "highest", "landing"]
    assert lines[3].split() == ["13", "-3.50", "inverted", "20.00", "180.00", "45.50"]
    assert f"revision {anna.calibration().revision}, kept on the robot" in end.stderr


def test_the_landing_pose_is_where_the_running_servos_stand(gateway: Gateway, anna: Client) -> None:
    nobody = gateway.run("calibrate", "--landing")
    assert nobody.returncode == 1
    assert "no servo of the robot runs" in nobody.stdout
    assert anna.start_leg(1, 50, 60, 70).accepted
    assert anna.start_leg(2, 80, 85, 90.25).accepted
    unasked = gateway.run("calibrate", "--landing")
    assert (unasked.returncode, unasked.stdout.splitlines()[-1]) == (
        1,
        "nothing is written: nobody can be asked here, since there is no terminal; --yes agrees",
    )
    end = gateway.run("calibrate", "--landing", "--leg", "2", "--yes")
    assert end.returncode == 0, str(end)
    assert re.search(r"^ +23 +90\.25$", end.stdout, re.MULTILINE)
    landing = anna.calibration().landing
    assert {name: angle for name, angle in landing.items() if name[0] in "12" and name != "13"} == {
        "21": 80,
        "22": 85,
        "23": 90.25,
    }
    assert all(servo.running for servo in anna.state().legs[0].servos), "it stops nobody, and needs no lease for that"


def test_the_landing_pose_waits_for_who_drives(gateway: Gateway, anna: Client) -> None:
    def lets_go(_: str) -> None:
        anna.stop()
        lease.release()

    with anna.lease(on_asked=lets_go) as lease:
        assert anna.start_leg(5, 50, 60, 70).accepted
        end = gateway.run("calibrate", "--landing", "--leg", "5", "--yes")
    assert end.returncode == 0, str(end)
    assert "anna drives, and is asked for the lease" in end.stderr
    assert anna.calibration().landing["53"] == 70


def test_the_landing_pose_under_this_users_own_lease(gateway: Gateway, anna: Client) -> None:
    with gateway.begin("lease", "acquire") as holder:
        holder.wait_for_line(0)
        assert gateway.run("send", "leg", "6", "start", "50", "60", "70").returncode == 0
        end = gateway.run("calibrate", "--landing", "--leg", "6", "--yes")
        assert end.returncode == 0, str(end)
    assert anna.calibration().landing["63"] == 70


def test_a_broken_file_is_shown_and_replaced_by_the_default_once_somebody_says_so(tmp_path: Path) -> None:
    kept = tmp_path / "calibration.toml"
    kept.write_text("half a fi")
    with Gateway(tmp_path, {"calibration": {"path": str(kept)}}) as gateway:
        asked = gateway.run("calibrate", "--accept-default")
        assert asked.returncode == 1
        assert "calibration.toml: is not TOML" in asked.stdout
        with at_terminal(tmp_path, "calibrate", gateway.endpoint) as terminal:
            assert terminal.wait_for_end() == 1
            assert "calibrate --accept-default" in terminal.words
        end = gateway.run("calibrate", "--accept-default", "--yes")
        assert end.returncode == 0, str(end)
        with gateway.client() as client:
            assert client.start_leg(1, 1, 2, 3).accepted
        again = gateway.run("calibrate", "--accept-default", "--yes")
        assert again.returncode == 0
        assert again.stdout.startswith("there is nothing to accept: revision ")
    assert (tmp_path / "calibration.broken.toml").read_text() == "half a fi"


def test_options_that_do_not_go_together() -> None:
    with pytest.raises(ConfigError, match="one at a time"):
        calibrate(show=True, landing=True)
    with pytest.raises(ConfigError, match="--leg goes with --landing"):
        calibrate(leg=[3])
