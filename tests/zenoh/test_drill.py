"""The drill: passes on a gateway that works, finds each planted mistake by the right step, and ends stopped."""

import json
import os
import re
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.errors import ConfigError
from gateway.people.tools.drill import report, steps, watching
from gateway.people.tools.drill.steps import STEPS
from gateway.people.tools.robot_side import StepName
from schemas.calibration import ServoChange
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import frames
from tests.support.planted_gateway import MISTAKES
from tests.support.secured import Secured

pytestmark = pytest.mark.full

LATE_MS: Final = 70
"""For a machine that is busy with other tests; what is planted is later."""
FRAMES: Final[dict[str, dict[str, Any]]] = {"telemetry": {"frames": True}}


gateway = gateway_fixture(FRAMES)


def test_it_passes_on_a_robot_that_works_and_reports_it(tmp_path: Path) -> None:
    """With certificates: the robot's is good for its own address, and not for where the drill cuts the link."""
    report = tmp_path / "drill.html"
    with Secured(tmp_path, FRAMES, address="127.0.0.2", hosts=["127.0.0.2"]) as robot:
        operator = str(robot.folder / "anna.json5")
        done = robot.gateway.run("drill", "--zenoh-config", operator, "--late", str(LATE_MS), "--report", str(report))
        assert done.returncode == 0, str(done)
        with robot.client("anna") as client:
            assert client.state().mode == "idle"
    assert done.stdout.count("PASS ") == len(STEPS) - 6, "six need a button, a device, systemd, or a power board"
    assert "PASS     cut-link" in done.stdout
    assert "all passed" in done.stdout
    text = report.read_text()
    assert "<h1>Drill: passed</h1>" in text
    assert text.count("<svg") >= 5
    assert "src=" not in text, "one file"


def test_a_whole_leg_moves_where_that_is_asked_for_and_json_tells_of_it(gateway: Gateway, tmp_path: Path) -> None:
    report = tmp_path / "drill.json"
    options = ("--move", "--leg", "3", "--angle", "180", "--only", "command", "--only", "silence")
    done = gateway.run("drill", *options, "--late", str(LATE_MS), "--report", str(report))
    assert done.returncode == 0, str(done)
    found = json.loads(report.read_text())
    assert [(step["name"], step["result"]) for step in found["steps"]] == [("command", "pass"), ("silence", "pass")]
    stop = "02"
    moved = [hex_bytes for _, hex_bytes, _ in found["steps"][0]["frames"] if hex_bytes[6:8] != stop]
    assert moved == ["0e011f01b4002001b4002101b400", "0e011f03a5002003a5002103a500"]
    assert abs(found["steps"][1]["figures"]["later_us"]) < LATE_MS * 1000


def test_without_frames_it_measures_by_the_state(tmp_path: Path) -> None:
    with Gateway(tmp_path) as running:
        done = running.run("drill", "--late", str(LATE_MS), "--only", "silence", "--only", "estop")
        assert done.returncode == 0, str(done)
        assert "publishes no frames" in done.stderr


def test_where_the_robot_lands_its_stop_is_expected_at_the_end_of_the_landing(tmp_path: Path) -> None:
    watchdog = {"timeout_ms": 100, "landing_ms": 300}
    with Gateway(tmp_path, {**FRAMES, "watchdog": watchdog, "watchdog.landing": {"11": 60.0}}) as running:
        report = tmp_path / "drill.html"
        done = running.run("drill", "--late", str(LATE_MS), "--only", "silence", "--report", str(report))
        assert done.returncode == 0, str(done)
        assert "watchdog 100 ms, then a landing of 300 ms" in report.read_text()
        assert "landing_ms 300" in done.stdout
        assert "must land the robot, then stop it" in done.stderr
        sent = running.run("send", "servo", "11", "start", "90")
        assert "stops it 100 ms after a command, once the robot has landed in 300 ms; " in sent.stderr


@pytest.mark.parametrize("required", [1, 2])
def test_it_is_a_stop_button_itself_where_one_more_is_required(tmp_path: Path, required: int) -> None:
    """And where two more are, it says how many people have to watch, and moves nothing."""
    with Gateway(tmp_path, {**FRAMES, "buttons": {"required": required, "timeout_ms": 300}}) as running:
        done = running.run("drill", "--late", str(LATE_MS), "--only", "button", "--only", "command")
        with running.client() as client:
            assert client.state().buttons.alive == 0, "it has left"
    if required == 2:
        assert done.returncode == 2, str(done)
        assert "0 of the 2 stop buttons that are required are alive" in done.stderr
        assert "keep 1 alive meanwhile" in done.stderr
        return
    assert done.returncode == 0, str(done)
    assert re.search(r"PASS     button         timeout_ms 300.0, check_in_to_sixth_stop_ms \d+", done.stdout)


def test_where_enough_others_watch_its_own_silence_would_stop_nobody(tmp_path: Path) -> None:
    settings = {**FRAMES, "buttons": {"required": 1, "timeout_ms": 10_000}}
    with (
        Gateway(tmp_path, settings) as running,
        running.client() as client,
        client.button("kitchen") as kitchen,
    ):
        kitchen.alive()
        done = running.run("drill", "--late", str(LATE_MS), "--only", "button", "--only", "set-while-stopped")
    assert done.returncode == 0, str(done)
    assert "SKIPPED  button         1 stop buttons of other people are alive" in done.stdout
    assert "PASS     set-while-stopped" in done.stdout


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_planted_mistake_fails_its_step(mistake: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (steps, watching):
        monkeypatch.setattr(module, "EVIDENCE_S", 1.5)  # what does not come is waited for
    step = MISTAKES[mistake][1]
    program = (sys.executable, "-m", "tests.support.planted_gateway", mistake)
    settings = {**FRAMES, "buttons": {"required": int(step == "button"), "timeout_ms": 300}}
    with Gateway(tmp_path, settings, program=program) as planted:
        done = planted.run("drill", "--late", str(LATE_MS), "--only", step)
    assert done.returncode == 1, str(done)
    assert done.stdout.startswith(f"FAIL     {step:14} "), str(done)


ENDS: Final = {"command": signal.SIGINT, "after-reset": signal.SIGTERM, "cut-link": signal.SIGHUP}
"""Ctrl-C, a request to end, and the end of the terminal: with one client, with a stream, and with what a link holds."""
STARTED: Final = "06020b015a00"


@pytest.mark.parametrize("step", ENDS)
def test_whoever_ends_it_finds_all_legs_stopped(gateway: Gateway, step: str) -> None:
    """Also whoever is impatient, and ends it twice."""
    with gateway.client() as client:
        heard = frames(client)
        with gateway.begin("drill", "--only", step, "--only", "silence") as child:
            heard.wait(lambda record: record.bytes == STARTED)
            child.send_signal(ENDS[step])
            child.send_signal(ENDS[step])
            assert child.wait() == 1, str(child)
        assert "All legs are stopped." in child.stderr, str(child)
        assert "NOT passed" in child.stdout
        assert client.state().mode == "idle"


def test_where_the_gateway_is_gone_it_says_that_nobody_has_confirmed(tmp_path: Path) -> None:
    with Gateway(tmp_path, FRAMES) as running, running.client() as client:
        heard = frames(client)
        file = tmp_path / "drill.json"
        options = ("--only", "silence", "--only", "cut-link", "--timeout", "0.3", "--report", str(file))
        with running.begin("drill", *options) as child:
            heard.wait(lambda record: record.bytes == STARTED)
            running.child.kill()
            assert child.wait() == 4, str(child)
        assert "FAIL     silence" in child.stdout
        assert "Nobody has confirmed that all legs are stopped" in child.stderr
        found = json.loads(file.read_text())
        assert not found["passed"]
        assert [step["result"] for step in found["steps"]] == ["fail", "fail"], "and none is skipped for it"


def test_where_the_lease_is_taken_from_it_all_legs_are_stopped(gateway: Gateway) -> None:
    with gateway.client() as client:
        heard = frames(client)
        with gateway.begin("drill", "--only", "estop", "--only", "command") as child:
            child.wait_for_output("estop: engages", timeout_s=20)
            heard.wait(lambda record: record.bytes == STARTED)
            with client.lease(take=True):
                assert child.wait() == 1, str(child)
        assert "FAIL     estop" in child.stdout, str(child)
        assert "All legs are stopped." in child.stderr
        state = client.state()
        assert not any(servo.running for leg in state.legs for servo in leg.servos)
        if state.mode == "estopped":
            assert client.reset().accepted


def test_a_calibrated_servo_with_a_greatest_speed_passes(tmp_path: Path) -> None:
    with Gateway(tmp_path, {**FRAMES, "limits.servos.11": {"max_speed_deg_s": 20.0}}) as running:
        with running.client() as client:
            assert client.calibrate({11: ServoChange(trim_deg=3, inverted=True)}).accepted
        done = running.run("drill", "--late", str(LATE_MS), "--only", "command")
        assert done.returncode == 0, str(done)
        assert "frame 06020b015d00" in done.stdout, "180 - 90 + 3 = 93 degrees"


def test_a_robot_that_is_not_at_rest_is_left_alone(gateway: Gateway) -> None:
    with gateway.client() as client:
        client.estop()
        done = gateway.run("drill")
        assert done.returncode == 2
        assert "estopped" in done.stderr
        assert client.reset().accepted
        with client.lease():
            done = gateway.run("drill")
        assert done.returncode == 2, str(done)
        assert "drives, and nothing is moved" in done.stderr
    assert gateway.run("drill", "--only", "nonsense").returncode == 2


def test_a_report_that_cannot_be_written_is_reported_before_anything_moves(gateway: Gateway, tmp_path: Path) -> None:
    done = gateway.run("drill", "--report", str(tmp_path / "none" / "drill.html"))
    assert done.returncode == 2
    assert "there is no folder" in done.stderr
    assert done.stdout == ""
    with pytest.raises(ConfigError, match="it is a folder"):
        report.check(tmp_path)
    report.check(tmp_path / "drill.html")
    assert list(tmp_path.iterdir()) == []


def test_help_names_each_step() -> None:
    assert list(StepName) == [step.name for step in STEPS]


# ---- the step that kills the service (with a real systemd: tests/box/test_drill.py)

SYSTEMCTL = """#!/bin/sh
[ -z "{load}" ] && echo System has not been booted with systemd >&2 && exit 1
echo "$@" >> {folder}/asked
case $1 in
kill) kill -9 {pid} ;;
show) echo "LoadState={load}"
    echo "ExecMainStartTimestampMonotonic=$(($(cut -d. -f1 /proc/uptime) - {ago}))000000"
    echo "InvocationID=$(grep -c kill {folder}/asked)"
    echo "ExecStopPost={{ path=/opt/x ; argv[]=/opt/x stop-servos ; pid=7 ; {ended} }}"
    echo "ExecStopPost={{ path=/bin/cat ; argv[]=/bin/cat ; pid=8 ; code=exited ; status=0 }}" ;;
esac
"""


@pytest.fixture
def systemctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A systemctl of the test's own, which shows this, and kills this process."""

    def install(pid: int, load: str = "loaded", ago: int = 0, ended: str = "") -> None:
        program = tmp_path / "systemctl"
        program.write_text(SYSTEMCTL.format(folder=tmp_path, pid=pid, ended=ended, load=load, ago=ago))
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")

    return install


@pytest.mark.parametrize(
    ("load", "ago", "says"),
    [
        ("", 0, "systemd on this machine reports no service"),
        ("not-found", 0, "this machine has no hexapod-gateway.service"),
        ("loaded", -1000, "hexapod-gateway.service of this machine is not the gateway that answers"),
    ],
)
def test_a_laptop_skips_the_step_that_kills_the_service(
    gateway: Gateway, systemctl: Callable[..., None], load: str, ago: int, says: str
) -> None:
    """Also one that has a service of its own, which would die in the place of the robot's."""
    systemctl(gateway.child.pid, load, ago)
    done = gateway.run("drill", "--yes", "--restart", "--only", "restart")
    assert done.returncode == 0, str(done)
    assert f"SKIPPED  restart        {says}" in done.stdout
    with gateway.client() as client:
        assert client.state().mode == "idle"


@pytest.mark.parametrize("ended", ["code=exited ; status=3", "code=(null) ; status=0/0"], ids=["failed", "not run"])
def test_a_stop_servos_that_did_not_stop_after_the_end_fails(
    tmp_path: Path, systemctl: Callable[..., None], ended: str
) -> None:
    """As systemd 252 shows it; the test is in the place of systemd, which starts the service again."""
    settings = {**FRAMES, "zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}}
    with ExitStack() as stack:
        first = stack.enter_context(Gateway(tmp_path, settings))
        systemctl(first.child.pid, ended=ended)

        def start_again() -> None:
            first.child.wait(20)
            stack.enter_context(Gateway(tmp_path, settings, wait=False))

        systemd = threading.Thread(target=start_again)
        systemd.start()
        done = first.run("drill", "--restart", "--only", "restart", timeout_s=60)
        systemd.join()
        assert done.stdout.startswith("FAIL     restart        stop-servos did not stop the servos"), str(done)
    assert "kill --signal=KILL hexapod-gateway.service" in (tmp_path / "asked").read_text()
