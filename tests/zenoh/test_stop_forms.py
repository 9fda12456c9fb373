"""A Stop over Zenoh in whatever form, by put and by get: it is rejected, and the leg is stopped."""

import json
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest

from gateway.client import Client
from schemas import keys
from schemas.telemetry import Ack, Cause, GatewayState, Reason
from tests.support.gateway_process import Gateway
from tests.support.heard import frames, running, states
from tests.support.stop_forms import FORMS, GOOD, Form

LEG_3 = keys.leg_command(3)
FORMS_OF_LEG = {name: form for name, (key, form) in FORMS.items() if key == LEG_3}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    settings: dict[str, dict[str, Any]] = {"watchdog": {"timeout_ms": 10_000}, "telemetry": {"frames": True}}
    with Gateway(tmp_path_factory.mktemp("gateway"), settings) as gateway, gateway.client() as client:
        yield client


def _asked(client: Client, form: Form, key: str = LEG_3) -> Ack:
    (reply,) = client.session.get(key, payload=form.payload, encoding=form.encoding, timeout=30)
    assert reply.ok is not None
    return Ack.model_validate_json(reply.ok.payload.to_bytes())


def _has_rejected(count: int, state: GatewayState) -> bool:
    return state.commands.rejected >= count


@pytest.mark.parametrize("form", FORMS_OF_LEG.values(), ids=FORMS_OF_LEG)
def test_a_stop_is_a_stop_in_whatever_form(client: Client, form: Form) -> None:
    seen, stops = states(client, kept=50), frames(client)
    rejected = client.state().commands.rejected
    for key, times in (LEG_3, 1), ("hexapod/leg/*/cmd", 6):
        assert client.start_leg(3, 90, 90, 90).accepted
        client.session.put(key, form.payload, encoding=form.encoding)
        rejected += times
        seen.wait(partial(_has_rejected, rejected))
        assert running(client) == []
    assert client.start_leg(3, 90, 90, 90).accepted
    started_ns = time.monotonic_ns()
    ack = _asked(client, form)
    assert (ack.accepted, ack.reason, ack.stopped) == (False, form.reason, True)
    assert running(client) == []
    stops.wait(lambda frame: frame.monotonic_ns > started_ns and frame.cause is Cause.COMMAND)


@pytest.mark.parametrize("encoding", GOOD)
def test_json_by_another_name_is_a_valid_stop(client: Client, encoding: str) -> None:
    assert client.start_leg(3, 90, 90, 90).accepted
    plain = json.dumps({"servos": [{"op": "stop"}] * 3}).encode()
    ack = _asked(client, Form(plain, Reason.BAD_ENCODING, encoding))
    assert (ack.accepted, ack.stopped) == (True, None)
    assert running(client) == []


def test_who_lists_what_there_is_stops_nothing(client: Client) -> None:
    """`get hexapod/**` reaches every command key, with an empty payload."""
    assert client.start_leg(3, 90, 90, 90).accepted
    answers = [reply.ok for reply in client.session.get("hexapod/**", timeout=30) if reply.ok is not None]
    acks = [json.loads(answer.payload.to_bytes()) for answer in answers if "leg/3" in str(answer.key_expr)]
    assert [(ack["accepted"], "stopped" in ack) for ack in acks] == [(False, False)]
    assert running(client) == [3]
    assert client.stop().accepted
