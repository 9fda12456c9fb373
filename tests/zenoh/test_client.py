"""The client that laptops use: its examples run, its errors are sentences, it finds its gateway and lets go of it."""

import doctest
import json
import math
import os
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Final

import numpy as np
import pytest

from gateway import client as client_module
from gateway.client import Client, RejectedError, StoppedError
from gateway.errors import UnansweredError, ZenohError
from gateway.people.client import blocking, lease, stream
from gateway.people.client.payloads import leg_payload
from schemas import keys
from schemas.ack import Ack
from schemas.words import Cause, Mode
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import frames, is_stop

MOST_LOOKS = 500
"""In 1.5 s: asked again every 50 ms, and each time a few calls. Without pauses they are many thousands."""

gateway = gateway_fixture()
patient_gateway = gateway_fixture(patient(4000, telemetry={"frames": True}))
robot = client_fixture("test", rests=True)


@pytest.mark.full
@pytest.mark.parametrize(("module", "examples"), [(client_module, 2), (blocking, 2), (stream, 2), (lease, 1)])
def test_the_examples_run(gateway: Gateway, module: ModuleType, examples: int) -> None:
    failed, tried = doctest.testmod(module, extraglobs={"endpoint": gateway.endpoint, "Client": Client})
    assert (failed, tried) == (0, examples)


def test_what_nobody_answers_is_one_sentence_and_no_busy_loop(tmp_path: Path) -> None:
    looks = 0

    def count(_frame: FrameType, kind: str, called: Any) -> None:
        nonlocal looks
        looks += kind == "c_call" and called.__name__ == "monotonic"

    with Gateway(tmp_path) as gateway, Client(gateway.endpoint, timeout_s=1.5) as client:
        client.state()
        gateway.child.kill()
        gateway.child.wait()
        for ask, why in (
            # By then the session may know that the link has ended, and may not.
            (lambda: client.start_leg(3, 1, 2, 3), r"(and the link may have been lost|within 1\.5 s)"),
            (client.state, r"within 1\.5 s"),
            (client.telemetry, r"within 1\.5 s"),
            (client.stop, r"within 1\.5 s"),
        ):
            looks = 0
            sys.setprofile(count)
            try:
                with pytest.raises(UnansweredError, match=f"^no gateway answered {why}; "):
                    ask()
            finally:
                sys.setprofile(None)
            assert 0 < looks < MOST_LOOKS


# ---- how it finds its gateway, and lets go of it


def test_a_closed_client_says_so(gateway: Gateway) -> None:
    client = gateway.client()
    stream = client.stream()
    stream.open()
    stream.set({3: (90, 45, 120)})
    client.close()
    client.close()
    for call in (
        client.state,
        client.stop,
        client.estop,
        lambda: client.start_leg(3, 1, 2, 3),
        lambda: client.publish(keys.leg_command(3), leg_payload("stop")),
        lambda: client.on_state(print),
        lambda: stream.set({3: (90, 45, 120)}),
    ):
        with pytest.raises(ZenohError, match="this client is closed; make a new one"):
            call()


def test_what_a_thread_still_does_comes_before_that_end(gateway: Gateway) -> None:
    program = f"""
import threading
from gateway.client import Client
robot = Client({gateway.endpoint!r})
heard = [robot.on_state(lambda state: None), robot.on_event(repr)]
print(robot.start_leg(3, 90, 45, 120).accepted)
def on():
    threading.main_thread().join()
    for _ in range(50):
        answer = robot.set_leg(3, 90, 45, 120, check=False)
    print("at last", answer.accepted)
threading.Thread(target=on).start()
"""
    with Child([sys.executable, "-c", program], os.environ) as child:
        assert child.wait(20) == 0, child.stderr
    assert "at last" in child.stdout, "also where this machine was too slow for the watchdog"


# ---- what is open is ended with its client


OPENED = """
from gateway.client import Client
robot = Client({endpoint!r}, source="notebook")
{opened}
"""
STREAM = """stream = robot.stream(20).open()
for _ in range(3): stream.set([(90, 45, 120)] * 6)

print(stream)"""
WALK = """walk = robot.walk().open()
walk.stand()
print(walk)"""


@pytest.mark.parametrize(
    ("opened", "end", "interactive"),
    [(STREAM, "", False), (STREAM, "1 / 0", True), (WALK, "raise SystemExit(3)", True), (WALK, "1 / 0", False)],
    ids=["a stream in a script", "and interactively, after an error", "a walk interactively", "and after an error"],
)
def test_a_program_that_closes_nothing_leaves_nothing_to_the_watchdog(
    patient_gateway: Gateway, opened: str, end: str, interactive: bool
) -> None:
    shown = r"<Stream 20 Hz, open, all legs started, \d+ missed>" if opened == STREAM else "<Walk tripod, standing>"
    with patient_gateway.client() as watcher:
        watcher.stop()
        before, written = watcher.state(), frames(watcher)
        code = OPENED.format(endpoint=patient_gateway.endpoint, opened=opened) + end + "\n"
        command = [sys.executable, "-q", "-i", "-"] if interactive else [sys.executable, "-"]
        done = subprocess.run(command, input=code, capture_output=True, text=True, check=False, timeout=120)
        assert re.search(shown, done.stdout), done.stderr
        after = watcher.state()
        assert after.lease.holder is None
        assert not any(leg.running for leg in after.legs)
        assert after.watchdog.expirations == before.watchdog.expirations
        stops = [record for record in written.all if record.cause is Cause.COMMAND and is_stop(record)]
        assert len(stops) == 6


# ---- what is rejected, and whether it is ready


STARTS_AND_SETS: Final[list[Callable[[Client, bool], Ack]]] = [
    lambda client, check: client.set_leg(3, 90, 45, 120, check=check),
    lambda client, check: client.set_legs({3: (90, 45, 120)}, check=check),
    lambda client, check: client.start_leg(1, 90, 45, 200, check=check),
    lambda client, check: client.start_legs([(90, 45, 4)] * 6, unit="rad", check=check),
    lambda client, check: client.calibrate({}, {31: 181}, check=check),
]


@pytest.mark.parametrize("call", STARTS_AND_SETS)
def test_what_is_rejected_raises_or_returns_its_answer(robot: Client, call: Callable[[Client, bool], Ack]) -> None:
    with pytest.raises(RejectedError) as error:
        call(robot, True)
    ack = call(robot, False)
    assert (ack.accepted, ack.reason, ack.detail) == (False, error.value.reason, error.value.detail)
    assert isinstance(error.value, ValueError) == (ack.reason == "invalid")


def test_stops_always_return_their_answer(robot: Client) -> None:
    with robot.lease(), Client(robot.robot[1], source="another") as other:
        answers = [other.stop(), other.stop(3), other.estop()]
        assert all(answer.accepted for answer in answers)
        assert {repr(answer).partition("(")[0] for answer in answers} == {"Ack"}, "no private name"
        answers = [other.stop(), other.stop(3), other.estop()]
        assert [answer.accepted for answer in answers] == [False, False, True], "they change nothing more"
        with pytest.raises(RejectedError):
            robot.reset((answers[-1].estop or 0) - 1)
    robot.reset()


def test_wait_ready_says_at_once_who_engaged_the_emergency_stop_and_its_command_resets_it(
    gateway: Gateway, robot: Client
) -> None:
    with Client(gateway.endpoint, source="bert") as bert:
        bert.estop()
    begun_s = time.monotonic()
    with pytest.raises(StoppedError) as error:
        robot.wait_ready(timeout_s=60)
    assert time.monotonic() - begun_s < 30, "at once"
    command = f"hexapod-gateway reset --connect {gateway.endpoint}"
    sentence = (
        f"emergency stop: nothing moves until a person runs `{command}`; the emergency stop was engaged by bert, "
    )
    assert re.fullmatch(re.escape(sentence) + r"\d+\.\d s ago", str(error.value))
    assert (error.value.by, error.value.cause) == ("bert", "estop_engaged")
    assert run_here(*command.split()[1:]).returncode == 0
    assert robot.wait_ready().mode == Mode.IDLE


# ---- what a person sees of it


def test_what_is_shown_of_objects_is_short(robot: Client) -> None:
    state = robot.state()
    assert repr(robot) == f"<Client 'test' of {robot.robot[1]}>"
    assert re.fullmatch(r"<GatewayState idle, legs that run: none, up \d+ s>", repr(state))
    assert re.fullmatch(r"<leg 3 is off( by 'test')?, \(.*\)>", str(state.leg(3)))


def test_angles_are_an_array_with_nan_for_a_servo_that_is_stopped(robot: Client) -> None:
    robot.start_legs([(90, 45, 120)] * 6)
    assert robot.state().angles().tolist() == [[90.0, 45.0, 120.0]] * 6
    assert robot.state().angles(unit="rad")[2][1] == pytest.approx(math.pi / 4)
    assert robot.stop().accepted
    assert np.isnan(robot.state().angles()).all()
    assert robot.state().angles().shape == (6, 3)
    with pytest.raises(KeyError):
        robot.state().leg(7)


# ---- the first of a laptop's hosts is no way to the robot: a Stop goes by the second one


MOST_S = 9.0
"""Half a second was measured; Zenoh's own patience with a silent host is ten."""


@pytest.mark.parametrize("silent", [False, True])
def test_a_stop_goes_by_the_second_host(tmp_path: Path, silent: bool) -> None:
    """The first rejects connections, or accepts them and then says nothing."""
    with Gateway(tmp_path) as gateway, socket.socket() as first:
        first.bind(("127.0.0.1", 0))
        if silent:
            first.listen()
        nowhere = f"tcp/127.0.0.1:{first.getsockname()[1]}"
        hosts = tmp_path / "hosts.json5"
        transport = {"unicast": {"open_timeout": 1000}}
        connect = {"endpoints": [nowhere, gateway.endpoint]}
        hosts.write_text(json.dumps({"mode": "client", "connect": connect, "transport": transport}))
        begun_s = time.monotonic()
        with Client(None, zenoh_config=hosts, timeout_s=10) as client:
            assert client.estop().stop_frames == 6
        assert time.monotonic() - begun_s < MOST_S
