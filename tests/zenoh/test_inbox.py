"""Every key and every verb, through the real Zenoh from one process to another; and floods."""

import json
from collections.abc import Iterator

import pytest

from gateway.client import Client, leg_payload, servo_payload
from gateway.model.frames import OneLeg, OneServo, decode, stop_leg
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Ack, FrameRecord, Kind, Mode, Reason
from tests.support.fixtures import gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames

START = leg_payload("start", (90, 45, 120))


gateway = gateway_fixture({"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 10_000}})


@pytest.fixture
def client(gateway: Gateway) -> Iterator[Client]:
    with gateway.client() as connected:
        connected.estop()
        connected.reset()
        yield connected


def frame_of(record: FrameRecord) -> OneLeg | OneServo:
    return decode(bytes.fromhex(record.bytes))


def running(client: Client) -> set[int]:
    return {servo.id for leg in client.state().legs for servo in leg.servos if servo.running}


@pytest.mark.parametrize("number", LEGS)
def test_a_legs_key_takes_put_get_and_delete(client: Client, number: int) -> None:
    heard = frames(client)
    key = keys.leg_command(number)
    first = servo_payload("start", 90)
    servos = {10 * number + joint for joint in (1, 2, 3)}
    client.publish(key, {"servos": [first] * 3})
    heard.wait(lambda record: frame_of(record).servos[0][0] == 10 * number + 1)
    assert running(client) == servos
    client.session.delete(key)
    heard.wait(lambda record: frame_of(record) == stop_leg(number))
    assert client.ask(key, START).accepted
    assert running(client) == servos


@pytest.mark.parametrize("servo_id", SERVO_IDS)
def test_a_servos_key_takes_put_get_and_delete(client: Client, servo_id: int) -> None:
    heard = frames(client)
    key = keys.servo_command(servo_id)
    client.publish(key, servo_payload("start", 90))
    heard.wait(lambda record: frame_of(record).servos[0][0] == servo_id)
    assert running(client) == {servo_id}
    client.session.delete(key)
    heard.wait(lambda record: record.bytes == f"0602{servo_id:02x}020000")
    assert client.ask(key, servo_payload("start", 1)).accepted
    assert running(client) == {servo_id}


def test_the_legs_key_takes_put_get_and_delete(client: Client) -> None:
    heard = frames(client)
    two = {"legs": {"2": START, "5": START}}
    client.publish(keys.LEGS_COMMAND, two)
    heard.wait(lambda record: frame_of(record).servos[0][0] == 51)
    assert running(client) == {21, 22, 23, 51, 52, 53}
    client.session.delete(keys.LEGS_COMMAND)
    heard.wait(lambda record: frame_of(record) == stop_leg(6))
    assert running(client) == set()
    assert client.ask(keys.LEGS_COMMAND, two).accepted
    assert running(client) == {21, 22, 23, 51, 52, 53}


@pytest.mark.parametrize(
    ("expression", "payload", "expected"),
    [
        ("hexapod/leg/*/cmd", START, set(SERVO_IDS)),
        ("hexapod/servo/*/cmd", servo_payload("start", 5), set(SERVO_IDS)),
        ("hexapod/servo/3$*/cmd", servo_payload("start", 5), {31, 32, 33}),
    ],
)
def test_a_wildcard_put_means_all_that_it_matches(
    client: Client, expression: str, payload: dict[str, object], expected: set[int]
) -> None:
    heard = frames(client)
    client.session.put(expression, json.dumps(payload))
    named: set[int] = set()
    for record in heard.each():
        named |= {servo_id for servo_id, _ in frame_of(record).servos}
        if named >= expected:
            break
    assert running(client) == expected


def test_a_wildcard_delete_stops_all_that_it_matches(client: Client) -> None:
    client.ask(keys.LEGS_COMMAND, {"legs": {"2": START, "5": START}})
    heard = frames(client)
    client.session.delete("hexapod/leg/*/cmd")
    heard.wait(lambda record: frame_of(record).is_stop, count=6)
    assert running(client) == set()


@pytest.mark.parametrize("payload", [b"", b"{}", b"\xff\x00 no JSON", b"x" * 60_000])
@pytest.mark.parametrize("verb", ["put", "get", "delete", "wildcard"])
def test_any_request_on_the_emergency_stops_key_engages_it(client: Client, payload: bytes, verb: str) -> None:
    client.start_leg(3, 90, 45, 120)
    heard = frames(client)
    match verb:
        case "put":
            client.session.put(keys.ESTOP, payload, encoding="image/png")
        case "get":
            (reply,) = client.session.get(keys.ESTOP, payload=payload)
            assert reply.ok is not None
            ack = Ack.model_validate_json(reply.ok.payload.to_bytes())
            assert (ack.accepted, ack.stop_frames) == (True, 6)
            assert ack.latency_us is not None
        case "delete":
            client.session.delete(keys.ESTOP)
        case "wildcard":
            client.session.put("hexapod/e$*/cmd", payload)
    heard.wait(lambda record: record.cause == "estop" and frame_of(record) == stop_leg(6))
    assert client.state().mode == Mode.ESTOPPED
    assert running(client) == set()


@pytest.mark.parametrize("key", ["hexapod/leg/0/cmd", "hexapod/leg/7/cmd", "hexapod/servo/14/cmd", "hexapod/x/y/cmd"])
def test_an_unknown_key_is_rejected_by_both_verbs_and_the_next_command_works(client: Client, key: str) -> None:
    heard = events(client)
    ack = client.ask(key, START)
    assert (ack.accepted, ack.reason) == (False, Reason.INVALID)
    client.session.put(key, json.dumps(START))
    event = heard.wait(lambda event: event.key == key, count=2)
    assert (event.kind, event.reason) == (Kind.COMMAND_REJECTED, Reason.INVALID)
    assert client.start_leg(3, 1, 2, 3).accepted
