"""Who is driving, asked of real gateways, with certificates and without; programs that hold the lease."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway import certs
from gateway.client import Client, LeaseLostError, RejectedError
from gateway.people.client.lease_requests import Identity
from gateway.people.client.payloads import leg_payload
from schemas import keys
from schemas.ack import Ack
from schemas.lease import LeaseAck
from schemas.words import Cause, Kind, Reason
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway, Secured, free_port
from tests.support.heard import events, frames, is_stop, running
from tests.support.robot import LEG_3, START, leg
from tests.support.waiting import wait_until
from tests.zenoh.test_reports import read

TTL_MS = 3000
STOP = leg("stop")


def answer(session: zenoh.Session, key: str, **fields: Any) -> bytes:
    text = json.dumps({name: value for name, value in fields.items() if value is not None})
    for reply in session.get(key, payload=text, encoding="application/json", timeout=20):
        if reply.ok is not None:
            return reply.ok.payload.to_bytes()
    raise TimeoutError("nobody answered")


def ask(session: zenoh.Session, do: str, source: str | None = None, **more: Any) -> LeaseAck:
    return LeaseAck.model_validate_json(answer(session, keys.LEASE, do=do, source=source, **more))


def command(session: zenoh.Session, payload: dict[str, Any], lease: str | None = None) -> Ack:
    return Ack.model_validate_json(answer(session, LEG_3, **payload, lease=lease))


def test_a_token_is_in_nothing_that_goes_out(tmp_path: Path) -> None:
    """Who may do what with one: tests/unit/robot/test_lease.py. Here: what is published, logged, counted and kept."""
    metrics = f"127.0.0.1:{free_port()}"
    settings: dict[str, dict[str, Any]] = {
        "lease": {"ttl_ms": TTL_MS},
        "telemetry": {"frames": True, "metrics": metrics},
        "state": {"path": str(tmp_path / "recorder")},
    }
    published: list[str] = []
    with Gateway(tmp_path, settings) as gateway, gateway.client() as client:
        session, heard = client.session, events(client)
        declared = [
            session.declare_subscriber(key, lambda sample: published.append(sample.payload.to_string()))
            for key in keys.PUBLISHED
        ]
        anna = ask(session, "acquire", "anna")
        assert (anna.accepted, anna.verified) == (True, False)
        assert command(session, START, anna.lease).accepted
        rejected = command(session, START)
        assert (rejected.reason, rejected.detail) == (Reason.NOT_HOLDER, "anna holds the lease")
        carl = ask(session, "take", "carl")
        assert command(session, START, anna.lease).reason == Reason.NOT_HOLDER
        assert command(session, STOP, anna.lease).accepted
        assert ask(session, "renew", lease=carl.lease).ttl_ms == TTL_MS
        page = read(metrics)
        assert 'hexapod_lease_info{holder="carl",verified="false"} 1.0' in page
        heard.wait(lambda event: f"carl was silent for {TTL_MS} ms" in event.detail)
        assert ask(session, "release", lease=carl.lease).reason == Reason.NOT_HOLDER
        gateway.child.terminate()
        gateway.child.wait()
        del declared
    out = {
        "published": "\n".join(published),
        "log": gateway.child.stdout + gateway.child.stderr,
        "metrics": page,
        "recorder": "".join(path.read_bytes().decode("latin-1") for path in tmp_path.rglob("*") if path.is_file()),
    }
    for token in (anna.lease, carl.lease):
        assert token is not None
        for where, text in out.items():
            assert text, where
            assert token not in text, where
            assert bytes.fromhex(token).decode("latin-1") not in text, where


def test_with_certificates_a_name_is_proved(tmp_path: Path) -> None:
    with Secured(tmp_path) as secured:
        certs.folder.issue(secured.folder, "bert", "operator")

        def claim(session: zenoh.Session, do: str, who: str, source: str | None = None) -> LeaseAck:
            nonce = ask(session, "challenge").nonce
            assert nonce is not None
            identity = Identity(secured.folder / f"{who}.pem", secured.folder / f"{who}.key")
            return ask(session, do, source or who, proof=identity.prove(do, source or who, nonce))

        with secured.client("anna") as anna, secured.client("bert") as bert, secured.client("otto") as otto:
            ack = claim(anna.session, "acquire", "anna")
            assert (ack.accepted, ack.holder, ack.verified) == (True, "anna", True)
            assert command(anna.session, START, ack.lease).accepted
            assert command(bert.session, START).reason == Reason.NOT_HOLDER
            for denied in (claim(bert.session, "take", "bert", "anna"), ask(bert.session, "take", "bert")):
                assert denied.reason == Reason.LEASE_DENIED
            assert claim(bert.session, "acquire", "bert").reason == Reason.LEASE_HELD
            assert command(bert.session, STOP).accepted
            with pytest.raises(TimeoutError):
                ask(otto.session, "challenge")
            assert otto.state().lease.verified
            assert claim(bert.session, "take", "bert").accepted
            assert command(anna.session, START, ack.lease).reason == Reason.NOT_HOLDER


POSE = (90, 45, 120)

# For setpoints every 20 ms, on a machine that may be busy for longer than the watchdog's 250.
gateway = gateway_fixture(patient(1000, telemetry={"frames": True}))
anna = client_fixture("anna", rests=True)
bert = client_fixture("bert")


def test_a_stop_carries_no_token(anna: Client, bert: Client) -> None:
    """It needs none, and nothing about one can make it fail."""
    asked: dict[str, bytes] = {}

    def hear(query: zenoh.Query) -> None:
        asked[str(query.key_expr)] = query.payload.to_bytes() if query.payload else b""

    wanted = (keys.LEGS_COMMAND, keys.leg_command(1), keys.servo_command(21), keys.ESTOP)
    declared = [bert.session.declare_queryable(key, hear) for key in wanted]
    bert.state()
    with anna.lease():
        wait_until(lambda: anna.start_leg(1, *POSE).accepted and keys.leg_command(1) in asked, "she knows who listens")
        assert b'"lease"' in asked.pop(keys.leg_command(1))
        for stop in (
            anna.stop,
            partial(anna.stop, 1),
            partial(anna.ask, keys.servo_command(21), {"op": "stop"}, again=True),
            anna.estop,
        ):
            assert stop().accepted
        assert anna.reset().accepted
    assert set(asked) == {*wanted}
    assert not [payload for payload in asked.values() if b'"lease"' in payload]
    for each in declared:
        each.undeclare()


def test_what_was_published_after_a_loss_moves_nothing_though_nobody_drives(anna: Client, bert: Client) -> None:
    heard = events(bert)
    with anna.lease() as lease:
        assert anna.start_leg(1, *POSE).accepted
        with bert.lease(take=True):
            pass
        anna.publish(keys.leg_command(1), leg_payload("start", POSE))
        rejected = heard.wait(lambda event: event.key == keys.leg_command(1))
        assert (rejected.source, rejected.reason) == ("anna", Reason.NOT_HOLDER)
        assert running(bert) == []
        with pytest.raises(LeaseLostError):
            anna.start_leg(1, *POSE)
        assert lease.lost is not None
    assert anna.start_leg(1, *POSE).accepted, "outside it is a program that does nothing about leases"


def test_a_rejected_bystander_stops_nobody(gateway: Gateway, anna: Client, bert: Client) -> None:
    """One that gives up, and one that does not."""
    with gateway.client() as watcher, anna.lease(), anna.stream(50) as stream:
        happened, written = events(watcher), frames(watcher)
        stream.set({1: POSE, 2: POSE})
        with pytest.raises(RejectedError, match="lease is held by anna"), bert.stream(50) as rejected:
            rejected.set({1: POSE, 6: POSE})
        with bert.stream(50) as rejected:
            for _ in range(2):
                with pytest.raises(RejectedError, match="lease is held by anna"):
                    rejected.set({1: POSE, 6: POSE})
                rejected.start_again()
        for _ in range(10):
            stream.set({1: POSE, 2: POSE})
        assert running(watcher) == [1, 2]
        assert not [record for record in written.all if record.cause is Cause.COMMAND and is_stop(record)]
        assert not [event for event in happened.all if event.kind == Kind.SOURCE_CHANGED]
