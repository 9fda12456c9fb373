"""The client that laptops use: its examples run, its errors are sentences, it finds its gateway and lets go of it."""

import doctest
import os
import sys
from pathlib import Path
from queue import SimpleQueue
from types import FrameType, ModuleType
from typing import Any

import pytest

from gateway import client as client_module
from gateway.client import Client, leg_payload
from gateway.errors import UnansweredError, ZenohError
from gateway.people.client import blocking, lease, stream
from schemas import keys
from schemas.telemetry import Telemetry
from tests.support.child import Child
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import Gateway, free_port
from tests.support.measuring import MEASURED, measuring

MOST_LOOKS = 500
"""In half a second: asked again every 50 ms, and each time a few calls. Without pauses they are many thousands."""

FORGETFUL = """
from gateway.client import Client
robot = Client({endpoint!r})
heard = [robot.on_state(lambda state: None), robot.on_event(repr)]
print(robot.start_leg(3, 90, 45, 120).accepted)
"""


gateway = gateway_fixture()
robot = client_fixture("test", rests=True)


@pytest.mark.full
@pytest.mark.parametrize(
    ("module", "examples"),
    [(client_module, 2), (blocking, 1), (stream, 2), (lease, 1)],
)
def test_the_examples_run(gateway: Gateway, module: ModuleType, examples: int) -> None:
    failed, tried = doctest.testmod(module, extraglobs={"endpoint": gateway.endpoint, "Client": Client})
    assert (failed, tried) == (0, examples)


def test_what_the_robot_measures_is_asked_for_and_called_back() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    received: SimpleQueue[Telemetry] = SimpleQueue()
    with measuring(endpoint) as robot, Client(endpoint, timeout_s=10) as client:
        subscriber = client.watch_telemetry(received.put)
        assert client.telemetry() is None, "nothing has come yet"  # and it knows the subscription
        robot.publish_rubbish()
        robot.publish(MEASURED)
        assert received.get(timeout=10) == MEASURED
        assert client.telemetry() == MEASURED
        subscriber.undeclare()
    with pytest.raises(ZenohError):
        client.telemetry()


def test_what_nobody_answers_is_one_sentence_and_no_busy_loop(tmp_path: Path) -> None:
    looks = 0

    def count(_frame: FrameType, kind: str, called: Any) -> None:
        nonlocal looks
        looks += kind == "c_call" and called.__name__ == "monotonic"

    with Gateway(tmp_path) as gateway, Client(gateway.endpoint, timeout_s=0.5) as client:
        client.state()
        gateway.child.kill()
        gateway.child.wait()
        for ask, why in (
            # By then the session may know that the link has ended, and may not.
            (lambda: client.start_leg(3, 1, 2, 3), r"(and the link may have been lost|within 0\.5 s)"),
            (client.state, r"within 0\.5 s"),
            (client.telemetry, r"within 0\.5 s"),
            (client.stop, r"within 0\.5 s"),
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
    later = """
import threading
def on():
    threading.main_thread().join()
    for _ in range(50):
        answer = robot.set_leg(3, 90, 45, 120)
    print("at last", answer.accepted)
threading.Thread(target=on).start()
"""
    child = Child([sys.executable, "-c", FORGETFUL.format(endpoint=gateway.endpoint) + later], os.environ)
    assert child.wait(20) == 0, child.stderr
    child.close()
    assert "at last" in child.stdout, "also where this machine was too slow for the watchdog"
