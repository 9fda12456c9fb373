"""`check --stops` passes on a gateway that works, finds each planted mistake by its step, and ends stopped."""

import json
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.onboard.check import stops
from gateway.onboard.check.move import Bench
from gateway.onboard.check.stops import STEPS
from gateway.onboard.check.table import FailedError
from gateway.people.commands.moving import ServoMotion
from tests.support.boards import RecordedBoard
from tests.support.command import Ended
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway, Secured, free_port
from tests.support.heard import frames, states
from tests.support.planted_gateway import MISTAKES
from tests.support.waiting import wait_until

pytestmark = pytest.mark.full

LATE_MS: Final = 2000
"""For a machine that is busy with other tests."""
PLANTED_MS: Final = 70
"""What is planted is later."""
FRAMES: Final[dict[str, dict[str, Any]]] = {"telemetry": {"frames": True}}

gateway = gateway_fixture(patient(1000, **FRAMES))


def test_check_stops_passes_on_a_robot_that_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With certificates, and where silence lands the robot before it stops it."""
    monkeypatch.setattr(stops, "_ANSWER_MS", LATE_MS)
    watchdog = {"timeout_ms": 1000, "landing_ms": 300}
    landing = {"watchdog.landing": {"11": 60.0, "31": 60.0}}
    settings = patient(2000, **FRAMES, watchdog=watchdog, limits={"takeover_deg_s": 180}, **landing)
    with Secured(tmp_path, settings) as robot:
        operator = ("--zenoh-config", str(robot.folder / "anna.json5"))
        done = robot.gateway.run("check", "--stops", *operator, "--leg", "3", "--late", str(LATE_MS), "--json")
        assert done.returncode == 0, str(done)
        with robot.client("anna") as client:
            assert client.state().mode == "idle"
    found = json.loads(done.stdout)
    assert found["passed"] is True
    results = {each["step"]: each["result"] for each in found["steps"]}
    assert list(results) == [step.name for step in STEPS]
    assert {name for name, result in results.items() if result == "PASS"} == {"command", "silence", "estop"}
    assert set(results.values()) == {"PASS", "SKIPPED"}, "the others need a device, systemd, or a power board"
    (silence,) = (each for each in found["steps"] if each["step"] == "silence")
    assert silence["figures"]["landing_ms"] == 300
    # The start comes soon after a Stop, 5° away: its last frame is 40 ms later than its first, and so is no silence.
    assert -25_000 < silence["figures"]["later_us"] < LATE_MS * 1000


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_planted_mistake_fails_its_step(mistake: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stops, "EVIDENCE_S", 1.5)  # what does not come is waited for
    step = MISTAKES[mistake][1]
    program = (sys.executable, "-m", "tests.support.planted_gateway", mistake)
    with Gateway(tmp_path, FRAMES, program=program) as planted:
        done = planted.run("check", "--stops", "--late", str(PLANTED_MS), "--only", step)
    assert done.returncode == 1, str(done)
    assert done.stdout.startswith(f"FAIL     {step:14} "), str(done)


def test_without_the_gateway_the_check_reports_that_nobody_confirmed(tmp_path: Path) -> None:
    with Gateway(tmp_path, FRAMES) as running, running.client() as client:
        heard = frames(client)
        with running.begin("check", "--stops", "--only", "silence", "--timeout", "0.3") as child:
            heard.wait(lambda record: record.bytes == STARTED)
            running.child.kill()
            assert child.wait() == 4, str(child)
        assert "FAIL     silence" in child.stdout
        assert "Nobody has confirmed that all legs are stopped" in child.stderr


ENDS: Final = {"command": signal.SIGINT, "estop": signal.SIGTERM, "silence": signal.SIGHUP}
"""Ctrl-C, a request to end, and the end of the terminal: with one client, with a stream, and with what a link holds."""
STARTED: Final = "06020b015a00"


@pytest.mark.parametrize("step", ENDS)
def test_every_end_of_the_check_stops_all_legs(gateway: Gateway, step: str) -> None:
    """Also if the person ends it twice."""
    with gateway.client() as client:
        heard = frames(client)
        with gateway.begin("check", "--stops", "--only", step, "--only", "stop-servos") as child:
            heard.wait(lambda record: record.bytes == STARTED)
            child.send_signal(ENDS[step])
            child.send_signal(ENDS[step])
            assert child.wait() == 1, str(child)
        assert "All legs are stopped." in child.stderr, str(child)
        assert "NOT passed" in child.stdout
        assert client.state().mode == "idle"


def test_a_signal_that_a_callback_has_swallowed_ends_it_when_it_is_delivered_again(gateway: Gateway) -> None:
    with gateway.client() as client:
        bench = Bench(client, ServoMotion(31, 90))
        with stops._ended_stopped(bench):
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGINT)
            pytest.fail("the check goes on")
        assert not bench.running()


def test_a_check_that_loses_the_lease_stops_all_legs(gateway: Gateway) -> None:
    with gateway.client() as client:
        heard = frames(client)
        with gateway.begin("check", "--stops", "--only", "estop", "--only", "command") as child:
            child.wait_for_output("estop: Engage", timeout_s=20)
            heard.wait(lambda record: record.bytes == STARTED)
            with client.lease(take=True):
                assert child.wait() == 1, str(child)
        assert "FAIL     estop" in child.stdout, str(child)
        assert "All legs are stopped." in child.stderr
        state = client.state()
        assert not any(servo.running for leg in state.legs for servo in leg.servos)
        if state.mode == "estopped":
            assert client.reset().accepted


# ---- the step that kills the service (with a real systemd: tests/box/test_systemd.py)


@pytest.mark.parametrize(
    ("shown", "says"),
    [
        ({}, "this machine has no hexapod-gateway.service"),
        ({"LoadState": "not-found"}, "this machine has no hexapod-gateway.service"),
        ({"LoadState": "loaded"}, "hexapod-gateway.service of this machine is not the gateway that answers"),
    ],
)
def test_a_laptop_skips_the_step_that_kills_the_service(
    gateway: Gateway, monkeypatch: pytest.MonkeyPatch, shown: dict[str, str], says: str
) -> None:
    """A laptop may have a service of its own, which would be killed instead of the robot's."""
    monkeypatch.setattr(stops, "shown", lambda _: shown)
    done = gateway.run("check", "--stops", "--yes", "--restart", "--only", "restart")
    assert done.returncode == 0, str(done)
    assert f"SKIPPED  restart        {says}" in done.stdout
    with gateway.client() as client:
        assert client.state().mode == "idle"


@pytest.mark.parametrize("ended", ["code=exited ; status=3", "code=(null) ; status=0/0"], ids=["failed", "not run"])
def test_a_stop_servos_that_fails_after_the_kill_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended: str
) -> None:
    """`shown` is what systemd 252 prints. The test starts the service again, as systemd does."""
    settings = {**FRAMES, "zenoh": {"listen": [f"tcp/127.0.0.1:{free_port()}"]}}
    asked: list[tuple[str, ...]] = []
    with ExitStack() as stack:
        first = stack.enter_context(Gateway(tmp_path, settings))
        shown = {
            "LoadState": "loaded",
            "ExecMainStartTimestampMonotonic": f"{time.monotonic_ns() // 1000}",
            "ExecStopPost": f"{{ path=/opt/x ; argv[]=/opt/x stop-servos ; pid=7 ; {ended} }} "
            "{ path=/bin/cat ; argv[]=/bin/cat ; pid=8 ; code=exited ; status=0 }",
        }

        def run(*words: str) -> None:
            asked.append(words)
            first.child.kill()
            stack.enter_context(Gateway(tmp_path, settings, wait=False))

        monkeypatch.setattr(stops, "shown", lambda _: {**shown, "InvocationID": str(len(asked))})
        monkeypatch.setattr(stops, "_run", run)
        done = first.run("check", "--stops", "--restart", "--only", "restart", timeout_s=60)
    assert done.stdout.startswith("FAIL     restart        stop-servos did not stop the servos"), str(done)
    assert asked == [("systemctl", "kill", "--signal=KILL", "hexapod-gateway.service")]


# ---- the steps for a power board: what it confirms, and one of its two ways unplugged


Check = Callable[..., Ended]


@pytest.fixture
def board(tmp_path: Path) -> Iterator[RecordedBoard]:
    with RecordedBoard(tmp_path) as running:
        yield running


@pytest.fixture
def check(tmp_path: Path, board: RecordedBoard, monkeypatch: pytest.MonkeyPatch) -> Iterator[Check]:
    monkeypatch.setattr(stops, "_ANSWER_MS", LATE_MS)
    power = {**board.settings, "confirm_ms": 500}

    with (
        Gateway(tmp_path, patient(1000, telemetry={"frames": True}, power=power)) as gateway,
        gateway.client() as client,
    ):
        states(client).wait(lambda _: stops.is_at_rest(client))

        def run(step: str, answer: Callable[[str], str] | None = None, *options: str) -> Ended:
            if answer is not None:
                monkeypatch.setattr(stops, "by_hand", stops.board)
                for name in ("ask", "hint"):
                    monkeypatch.setattr(stops, name, answer)
            return gateway.run("check", "--stops", *options, "--late", str(LATE_MS), "--only", step)

        yield run


def test_the_board_confirms_an_emergency_stop(check: Check) -> None:
    done = check("power", None, "--unplug")
    assert done.returncode == 0, str(done)
    assert "PASS     power          confirmed_after_ms " in done.stdout


@pytest.mark.parametrize(("repeated_by", "code"), [("check", "accepted"), ("anna", "a newer emergency stop")])
def test_only_its_own_emergency_stop_is_reset_however_often_it_was_sent(
    gateway: Gateway, repeated_by: str, code: str
) -> None:
    with gateway.client(source="check") as client, gateway.client(source=repeated_by) as other:
        bench = Bench(client, ServoMotion(11, 90.0))
        bench.estop = client.estop().estop or 0
        other.estop()
        if code == "accepted":
            bench.reset()
        else:
            with pytest.raises(FailedError, match=code):
                bench.reset()
            assert client.reset().accepted


def test_steps_without_a_person_to_unplug_are_skipped(check: Check) -> None:
    for step, *options in (("spi-unplugged", "--unplug"), ("can-unplugged", "--unplug"), ("can-unplugged",)):
        assert "SKIPPED" in check(step, None, *options).stdout


@pytest.mark.parametrize(("loose", "code"), [("yes", 0), ("no", 1)])
def test_with_spi_unplugged_the_emergency_stop_cuts_the_power(
    board: RecordedBoard, check: Check, loose: str, code: int
) -> None:
    """The supply comes back only once the controller has its Stops."""
    fed_when: dict[str, int] = {}

    def fed() -> int:
        return next((each.mask for each in reversed(board.noted) if each.what == "fed"), 0)

    def answer(question: str) -> str:
        word = question.split(maxsplit=1)[0]
        if word == "Unplug":
            wait_until(lambda: fed() != 0, "the board's process writes it down a moment later")
        fed_when[word] = fed()
        return loose

    done = check("spi-unplugged", answer, "--unplug")
    assert done.returncode == code, str(done)
    assert fed_when["Turn"] == fed_when["Plug"] == 0


def test_with_can_unplugged_the_robot_is_stopped_over_spi(board: RecordedBoard, check: Check) -> None:

    def answer(question: str) -> str:
        board.disturb(silent=question.startswith("Unplug"))
        return ""

    done = check("can-unplugged", answer, "--unplug")
    assert done.returncode == 0, str(done)
    assert "silent_when_reported_ms" in done.stdout
