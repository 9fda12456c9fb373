"""`run --sim=physics`: a robot with a body, in a process of its own, as viewers and people meet it."""

import os
from pathlib import Path
from typing import Final

import pytest
import zenoh

from schemas import keys
from schemas.words import Kind
from tests.support.child import Child
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import bodies, events
from tests.support.recordings import read

pytestmark = pytest.mark.full

PHYSICS: Final = ("--sim=physics",)
PATIENT: Final[dict[str, dict[str, object]]] = {"watchdog": {"timeout_ms": 10_000}, "lease": {"ttl_ms": 10_000}}
"""A machine that is busy with other tests stops no walk."""

gateway = gateway_fixture(PATIENT, options=PHYSICS)


def test_a_simulated_body_walks_and_sinks_at_an_emergency_stop(gateway: Gateway) -> None:
    """It stands up, walks ten centimetres, sinks at an emergency stop, and stands up again."""
    with gateway.client() as client:
        assert client.state().simulated
        heard = bodies(client)
        lying = heard.wait(lambda _: True)
        assert lying.upright
        assert lying.position_m[2] < 0.08
        with client.walk() as walk:
            walk.stand()
            standing = heard.wait(lambda body: body.position_m[2] > 0.14 and all(body.feet))
            assert any(servo.torque_nm for servo in standing.servos.values())
            while heard.all[-1].position_m[0] < standing.position_m[0] + 0.1:
                walk.go(0.08)
            walk.stand()
            pose = client.state().legs[0].servos[1].angle_deg
            assert pose is not None
            heard.wait(lambda body: abs(body.servos["12"].angle_deg - pose) < 5)
            stopped = client.estop()
            assert stopped.accepted
            fallen = heard.wait(lambda body: body.position_m[2] < 0.1 and body.position_m[0] > 0.05)
            assert fallen.velocity_m_s[2] < 0
            client.reset(stopped.estop)
            walk.start_again()


def test_what_another_program_publishes_there_is_reported_and_recognised(gateway: Gateway, tmp_path: Path) -> None:
    """The state names the process that counts; `record` leaves others out."""
    ride = tmp_path / "ride.mcap"
    with gateway.client() as client:
        heard, reported = bodies(client), events(client)
        body = heard.wait(lambda _: True)
        recorder = Child([*COMMAND, "record", str(ride), "--connect", gateway.endpoint], os.environ)
        recorder.wait_for_output("recording into")
        forged = body.model_copy(update={"position_m": (9.0, 9.0, 9.0)}).model_dump_json()
        publisher = client.session.declare_publisher(keys.SIM_BODY)
        before = len(heard.all)
        for number in range(30):  # beside the true ones
            publisher.put(forged, source_info=zenoh.SourceInfo(publisher.id, number))
            heard.wait(lambda body: body.position_m[0] < 9.0, count=before + number)
        event = reported.wait(lambda event: event.key == keys.SIM_BODY)
        assert event.kind is Kind.COMMAND_REJECTED
        assert "another program publishes it" in event.detail
        assert event.source == str(client.session.info.zid())
        recorder.terminate()
        assert recorder.wait() == 0
        assert "messages on the gateway's keys were no reports, and are not in the file" in recorder.stderr
        recorded = [message.content["position_m"] for message in read(ride) if message.topic == keys.SIM_BODY]
        assert len(recorded) > 10
        assert [9.0, 9.0, 9.0] not in recorded
        recorder.close()
        assert client.state().physics is not None
