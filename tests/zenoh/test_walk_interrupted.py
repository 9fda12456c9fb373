"""Ctrl-C and SIGTERM in a program of one's own that walks: the first has the robot sit down, the second stops it."""

import os
import signal
import sys

import pytest

from tests.support.child import Child
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import frames
from tests.zenoh.test_walk_command import seat, stopped_at

gateway = gateway_fixture(patient(10_000, telemetry={"frames": True}))

PROGRAM = """
from gateway.client import Client

with Client("{endpoint}") as robot, robot.walk() as walk:
    walk.stand()
    print("it stands", flush=True)
    while True:
        walk.go(forward_m_s=0.05)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("again", [False, True], ids=["once", "twice"])
def test_the_first_sits_and_the_second_stops(gateway: Gateway, number: signal.Signals, again: bool) -> None:
    with gateway.client() as watcher:
        written = frames(watcher)
        child = Child([sys.executable, "-c", PROGRAM.format(endpoint=gateway.endpoint)], os.environ)
        try:
            child.wait_for_output("it stands", 60)
            child.send_signal(number)
            if again:
                walked = len(written.all)
                written.wait(lambda _: True, count=walked + 6)  # it sits down, and has not got far
                child.send_signal(number)
            code = child.wait(60)
        finally:
            child.close()
        assert code == {signal.SIGINT: -signal.SIGINT, signal.SIGTERM: 128 + signal.SIGTERM}[number], str(child)
        state = watcher.state()
        assert (state.mode, state.lease.holder) == ("idle", None)
        assert (stopped_at(written.all) == pytest.approx(seat(), abs=0.02)) is not again
