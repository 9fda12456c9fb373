"""Who is driving, asked of real gateways: with certificates and without, and no token in anything that goes out."""

import json
import threading
import urllib.request
from pathlib import Path
from typing import Any

import pytest
import zenoh

from gateway import certs
from gateway.people.client.requests import Identity
from schemas import keys
from schemas.lease import LeaseAck
from schemas.telemetry import Ack, Reason
from tests.support.gateway_process import Gateway, free_port
from tests.support.robot import leg
from tests.support.secured import Secured

LEG_3 = keys.leg_command(3)
TTL_MS = 3000
START, STOP = leg("start", 90, 90, 90), leg("stop")


def ask(session: zenoh.Session, do: str, source: str | None = None, **more: Any) -> LeaseAck:
    """One request, and its answer."""
    fields = {"do": do, **({} if source is None else {"source": source}), **more}
    for reply in session.get(keys.LEASE, payload=json.dumps(fields), encoding="application/json", timeout=20):
        if reply.ok is not None:
            return LeaseAck.model_validate_json(reply.ok.payload.to_bytes())
    raise TimeoutError("nobody answered")


def command(session: zenoh.Session, payload: dict[str, Any], lease: str | None = None) -> Ack:
    """An acknowledged command for leg 3."""
    text = json.dumps(payload if lease is None else {**payload, "lease": lease})
    for reply in session.get(LEG_3, payload=text, encoding="application/json", timeout=20):
        if reply.ok is not None:
            return Ack.model_validate_json(reply.ok.payload.to_bytes())
    raise TimeoutError("nobody answered")


class Heard:
    """All that a gateway publishes."""

    def __init__(self, session: zenoh.Session) -> None:
        self.lines: list[str] = []
        self._changed = threading.Condition()
        self._subscribers = [session.declare_subscriber(key, self._take) for key in keys.PUBLISHED]

    def _take(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.lines.append(sample.payload.to_string())
            self._changed.notify_all()

    def wait_for(self, *words: str) -> str:
        """The first line with all of these words."""

        def found() -> list[str]:
            return [line for line in self.lines if all(word in line for word in words)]

        with self._changed:
            assert self._changed.wait_for(found, 30), words
            return found()[0]


def test_a_lease_from_hand_to_hand_and_its_token_in_nothing_that_goes_out(tmp_path: Path) -> None:
    metrics = f"127.0.0.1:{free_port()}"
    settings: dict[str, dict[str, Any]] = {
        "lease": {"ttl_ms": TTL_MS},
        "telemetry": {"frames": True, "metrics": metrics},
        "state": {"path": str(tmp_path / "recorder")},
    }

    def read_page() -> str:
        with urllib.request.urlopen(f"http://{metrics}/metrics", timeout=20) as answer:
            return str(answer.read().decode())

    with Gateway(tmp_path, settings) as gateway, gateway.client() as client:
        session, heard = client.session, Heard(client.session)
        anna = ask(session, "acquire", "anna")
        assert (anna.accepted, anna.verified) == (True, False)
        assert command(session, START, anna.lease).accepted
        rejected = command(session, START)
        assert (rejected.reason, rejected.detail) == (Reason.NOT_HOLDER, "anna holds the lease")
        assert 'hexapod_lease_info{holder="anna",verified="false"} 1.0' in read_page()
        assert ask(session, "ask", "bert").holder == "anna"
        heard.wait_for("lease_asked", "bert")
        assert ask(session, "release", lease=anna.lease, to="bert").holder == "bert"
        bert = ask(session, "acquire", "bert")
        assert bert.accepted
        carl = ask(session, "take", "carl")
        heard.wait_for("lease_taken", "carl has stopped all legs and taken the lease from bert")
        heard.wait_for('"mode"', '"holder":"carl"')
        for former in (anna, bert):
            assert command(session, START, former.lease).reason == Reason.NOT_HOLDER
            assert ask(session, "renew", lease=former.lease).reason == Reason.NOT_HOLDER
            assert command(session, STOP, former.lease).accepted
        assert ask(session, "renew", lease=carl.lease).ttl_ms == TTL_MS
        page = read_page()
        assert 'hexapod_lease_changes_total{kind="lease_taken"} 1.0' in page
        heard.wait_for("lease_expired", f"carl was silent for {TTL_MS} ms")
        assert ask(session, "release", lease=carl.lease).reason == Reason.NOT_HOLDER
        gateway.child.terminate()
        gateway.child.wait(10)
    out = {
        "published": "\n".join(heard.lines),
        "log": gateway.child.stdout + gateway.child.stderr,
        "metrics": page,
        "recorder": "".join(path.read_bytes().decode("latin-1") for path in tmp_path.rglob("*") if path.is_file()),
    }
    for token in (anna.lease, bert.lease, carl.lease):
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
