"""Six legs are being started when somebody stops one: the answer says which of them run, and these are all that run."""

import threading
from pathlib import Path

import pytest

from gateway.client import Client
from schemas.robot import LEGS
from schemas.telemetry import Ack, Reason
from tests.support.gateway_process import Gateway

STAGGER_MS = 250


@pytest.mark.parametrize("stopped", [4, 6])
@pytest.mark.parametrize("running", [1, 2])
def test_a_stop_while_legs_wait_to_be_started(tmp_path: Path, stopped: int, running: int) -> None:
    settings = {"limits": {"start_stagger_ms": STAGGER_MS}, "watchdog": {"timeout_ms": 8000}}
    with Gateway(tmp_path, settings) as gateway, gateway.client() as client, gateway.client() as other:
        answers: list[Ack] = []
        asking = threading.Thread(target=lambda: answers.append(client.start_legs(dict.fromkeys(LEGS, (90, 90, 90)))))
        asking.start()
        wait_for_running(other, running)
        assert other.stop(stopped).accepted
        asking.join(timeout=10)
        (ack,) = answers
        assert (ack.accepted, ack.reason) == (False, Reason.SERVO_STOPPED)
        runs = [leg.leg for leg in other.state().legs if any(servo.running for servo in leg.servos)]
        assert ack.written == runs
        assert runs == list(LEGS[: len(runs)])
        assert running <= len(runs) < stopped


def wait_for_running(client: Client, count: int) -> None:
    """Until so many legs run; each look is a question, which takes its time."""
    while sum(any(servo.running for servo in leg.servos) for leg in client.state().legs) < count:
        pass
