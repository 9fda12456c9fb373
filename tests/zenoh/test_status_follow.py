"""`status --follow` beside a running gateway: its lines, what it waits for, and its end."""

import os
import signal

from tests.support.child import Child
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway

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
        assert not client.servo(42, "set", 90, check=False).accepted
        line = child.wait_for_output("command_rejected")
        assert "anna: servo_stopped: servo 42 does not run" in line
        assert client.estop().accepted
        child.wait_for_output("estop_engaged")
        child.wait_for_output("Emergency stop by anna: nothing runs until a reset.")
        assert client.reset().accepted
        child.send_signal(signal.SIGTERM)
        assert child.wait(20) == 0
