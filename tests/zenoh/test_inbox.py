"""Every key and every verb, through the real Zenoh from one process to another; and floods."""

import json
import time
from contextlib import closing
from queue import SimpleQueue

import pytest
import zenoh
from zenoh.handlers import RingChannel

from gateway.client import Client
from gateway.host.settings_table import ZenohSettings
from gateway.model.frames import Frame, decode, stop_leg
from gateway.people.client.payloads import leg_payload, servo_payload
from gateway.robot.zenoh_io.outbox import ZenohOutbox
from gateway.robot.zenoh_io.session import service_config
from gateway.robot.zenoh_io.unknown_keys import UnknownKeys
from gateway.zenoh.config import client_config, open_session
from schemas import keys
from schemas.ack import Ack
from schemas.event import FrameRecord
from schemas.keys import STATE, TELEMETRY
from schemas.robot import SERVO_IDS
from schemas.telemetry import Telemetry
from schemas.words import Cause, Kind, Mode
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import events, frames, servos_on
from tests.support.waiting import wait_until

START = leg_payload("start", (90, 45, 120))

gateway = gateway_fixture({"telemetry": {"frames": True}, "watchdog": {"timeout_ms": 10_000}})


client = client_fixture(None, rests=True)


def frame_of(record: FrameRecord) -> Frame:
    return decode(bytes.fromhex(record.bytes))


def servos_of(records: list[FrameRecord], *, stop: bool) -> set[int]:
    """Return the servos that commands have stopped, or started and set."""
    found = [frame_of(record) for record in records if record.cause == Cause.COMMAND]
    return {servo_id for frame in found if frame.is_stop is stop for servo_id, _ in frame.servos}


@pytest.mark.parametrize(
    ("key", "payload", "servos"),
    [
        (keys.leg_command(3), START, {31, 32, 33}),
        (keys.servo_command(62), servo_payload("start", 90), {62}),
        (keys.LEGS_COMMAND, {"legs": {"2": START, "5": START}}, {21, 22, 23, 51, 52, 53}),
        ("hexapod/leg/*/cmd", START, {*SERVO_IDS}),
        ("hexapod/servo/*/cmd", servo_payload("start", 5), {*SERVO_IDS}),
    ],
)
def test_each_kind_of_key_takes_put_get_and_delete_and_a_wildcard_means_all_that_it_matches(
    client: Client, key: str, payload: dict[str, object], servos: set[int]
) -> None:
    """Other wildcards: tests/unit/robot/test_intake.py."""
    heard = frames(client)
    client.publish(key, payload)
    heard.wait_for_all(lambda records: servos_of(records, stop=False) >= servos)
    assert servos_on(client.state()) == servos
    client.session.delete(key)
    heard.wait_for_all(lambda records: servos_of(records, stop=True) >= servos)
    assert servos_on(client.state()) == set()
    if "*" not in key:
        assert client.ask(key, payload).accepted
        assert servos_on(client.state()) == servos


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
    assert servos_on(client.state()) == set()


def test_a_flood_beside_the_keys_is_told_ten_times_a_second_and_a_command_goes_through(client: Client) -> None:
    heard, before = events(client), client.state().commands.rejected
    publisher = client.session.declare_publisher("hexapod/leg/3/set", congestion_control=zenoh.CongestionControl.DROP)
    begun_s = time.monotonic()
    for _ in range(5000):
        publisher.put(json.dumps(START))
    event = heard.wait(lambda event: event.kind is Kind.COMMAND_REJECTED)
    assert "hexapod/leg/3/cmd" in event.detail
    assert client.start_leg(3, 90, 45, 120).accepted
    assert client.state().commands.rejected - before <= 2 + 10 * (time.monotonic() - begun_s)


speaker = gateway_fixture({"wire": {"name": "elkapod-2025"}})


def test_the_outbox_knows_whether_anyone_listens() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    outbox = ZenohOutbox()
    assert not outbox.anyone_listens(STATE)
    with closing(open_session(service_config(ZenohSettings(listen=(endpoint,))))) as session:
        unknown_keys = UnknownKeys(session)  # which hears all of hexapod/, and counts for nobody
        outbox.open(session)
        assert not outbox.anyone_listens(STATE)
        with closing(open_session(client_config(endpoint))) as laptop:
            for key in (STATE, "hexapod/**"):
                subscriber = laptop.declare_subscriber(key, RingChannel(1))
                wait_until(lambda: outbox.anyone_listens(STATE))
                subscriber.undeclare()
                wait_until(lambda: not outbox.anyone_listens(STATE))
        assert unknown_keys.poll() is None
        outbox.close()


def test_what_is_measured_is_published_while_somebody_listens_and_answered(speaker: Gateway) -> None:
    """And rubbish is left out."""
    received: SimpleQueue[Telemetry] = SimpleQueue()
    with speaker.client() as client, speaker.client() as stranger:
        subscriber = client.on_telemetry(received.put)
        stranger.publish(TELEMETRY, {"battery": "full"})
        stranger.state()  # on the same link, behind it
        while (published := received.get(timeout=30)).battery is None:
            pass
        assert (published.tilt_deg, published.feet) == (0.0, (0.0,) * 6)
        subscriber.undeclare()
        answered = client.telemetry()
        assert answered is not None
        assert answered.time >= published.time
        assert answered.imu is not None
