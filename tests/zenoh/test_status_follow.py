"""`status --follow` beside a running gateway: its lines, what it waits for, and its end."""

import json
import os
import signal
import subprocess
from pathlib import Path

from schemas.telemetry import Kind
from tests.support.child import Child
from tests.support.command import run_here
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway, free_port

PATIENT = patient(10_000)
gateway = gateway_fixture(PATIENT)
SILENT = "The gateway is SILENT: what the robot does is not known."


def following(endpoint: str, *options: str) -> Child:
    return Child([*COMMAND, "status", "--follow", "--connect", endpoint, *options], os.environ)


def test_it_shows_what_runs_each_rejection_and_why(gateway: Gateway) -> None:
    with following(gateway.endpoint) as child, gateway.client(source="anna") as client:
        child.wait_for_output("No servo runs.")
        assert client.start_leg(3, 90, 45, 120).accepted
        child.wait_for_output("Leg 3 runs.")
        assert not client.servo(42, "set", 90).accepted
        line = child.wait_for_output("command_rejected")
        assert "anna: servo_stopped: servo 42 does not run" in line
        assert client.estop().accepted
        child.wait_for_output("estop_engaged")
        child.wait_for_output("Emergency stop by anna: nothing runs until a reset.")
        assert client.reset().accepted
        child.send_signal(signal.SIGTERM)
        assert child.wait(20) == 0


def test_each_line_of_json_is_an_object(gateway: Gateway) -> None:
    with following(gateway.endpoint, "--json") as child, gateway.client(source="anna") as client:
        child.wait_for_output('"what": "robot"')
        assert not client.servo(42, "set", 90).accepted
        found = json.loads(child.wait_for_output("command_rejected"))
        assert (found["kind"], found["reason"]) == (Kind.COMMAND_REJECTED, "servo_stopped")
        child.send_signal(signal.SIGINT)
        assert child.wait(20) == 0
    assert all(isinstance(json.loads(line), dict) for line in child.stdout.splitlines())


def test_it_waits_for_a_gateway_and_says_when_one_hangs_dies_and_comes_back(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listen = {**PATIENT, "zenoh": {"listen": [endpoint]}}
    with following(endpoint, "--timeout", "0.5") as child:
        child.wait_for_output("no gateway answers on")
        with Gateway(tmp_path, listen) as first:
            child.wait_for_output("No servo runs.")
            first.child.send_signal(signal.SIGSTOP)
            child.wait_for_output(SILENT)
            first.child.send_signal(signal.SIGCONT)
            child.wait_for_output("The gateway publishes again, after ")
            first.child.kill()
            child.wait_for_output(SILENT)
        with Gateway(tmp_path, listen):
            child.wait_for_output("The gateway was started again.")


def test_it_ends_with_who_reads_it(gateway: Gateway) -> None:
    command = " ".join([*COMMAND, "status", "--follow", "--connect", gateway.endpoint])
    piped = ["bash", "-c", f"{command} | head -n 1"]
    with gateway.client() as client, subprocess.Popen(piped, stdout=subprocess.PIPE, text=True) as done:
        assert done.stdout is not None
        assert "No servo runs." in done.stdout.readline()
        while done.poll() is None:
            client.servo(42, "set", 90)  # of which there is a line that nobody reads
        assert done.returncode == 0


def test_a_faulty_file_ends_it_before_it_begins(tmp_path: Path) -> None:
    end = run_here("status", "--follow", "--zenoh-config", str(tmp_path / "absent.json5"))
    assert end.returncode == 2
    assert "absent.json5" in end.stderr
