"""Who is driving, asked of real gateways: with certificates and without, and no token in anything that goes out."""

import json
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway import certs
from gateway.people.client.lease_requests import Identity
from schemas import keys
from schemas.lease import LeaseAck
from schemas.telemetry import Ack, Reason
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import events
from tests.support.robot import LEG_3, START, leg
from tests.support.secured import Secured
from tests.zenoh.test_metrics import read

TTL_MS = 3000
STOP = leg("stop")


def answer(session: zenoh.Session, key: str, **fields: Any) -> bytes:
    """Return the answer to one request. Raise TimeoutError without any."""
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
