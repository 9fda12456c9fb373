"""The JSON Schemas say what the models say."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from pydantic import BaseModel, TypeAdapter, ValidationError

from gateway.errors import RejectedError
from schemas.__main__ import documents
from schemas.button import BUTTON_REQUEST, ButtonAck
from schemas.command import MAX_PAYLOAD_BYTES, SERVO_COMMAND, LegCommand, LegsCommand, ResetCommand
from schemas.keys import CommandKey, Target
from schemas.lease import LEASE_REQUEST, LeaseAck
from schemas.revocation import RevocationAck
from schemas.robot import LEGS
from schemas.state import StateReport
from schemas.telemetry import Ack, Cause, ConfigReport, Event, FrameRecord, Kind, Reason
from tests.support.commands import FAULTS, LEG, as_json

SCHEMAS = {name.removesuffix(".json"): json.loads(text) for name, text in documents().items()}
VALIDATORS = {name: Draft202012Validator(schema) for name, schema in SCHEMAS.items()}
COMMANDS: dict[str, TypeAdapter[Any]] = {
    "ServoCommand": SERVO_COMMAND,
    "LegCommand": TypeAdapter(LegCommand),
    "LegsCommand": TypeAdapter(LegsCommand),
    "ResetCommand": TypeAdapter(ResetCommand),
    "LeaseRequest": LEASE_REQUEST,
    "ButtonRequest": BUTTON_REQUEST,
}
NAMES = {
    Target.SERVO: "ServoCommand",
    Target.LEG: "LegCommand",
    Target.LEGS: "LegsCommand",
    Target.RESET: "ResetCommand",
}
NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def model_takes(name: str, payload: bytes) -> bool:
    try:
        COMMANDS[name].validate_json(payload)
    except ValidationError:
        return False
    return True


# ---- commands


VALUES: list[Any] = [
    None, True, 0, 1, 1.0, -1, 180, 180.5, 2**53, "", "1", "90", "stop", "x" * 64, "x" * 65, "0" * 32, [], {},
]  # fmt: skip
PROOF = {"nonce": "0" * 32, "certificate": "x", "signature": "x"}
FULL: list[tuple[str, dict[str, Any]]] = [
    ("ServoCommand", {"op": "set", "angle_deg": 1, "source": "x", "sent_ms": 1}),
    ("ServoCommand", {"op": "stop", "source": "x", "sent_ms": 1}),
    ("LegCommand", LEG | {"source": "x", "sent_ms": 1}),
    ("LegsCommand", {"legs": {"1": LEG, "6": LEG}, "source": "x", "sent_ms": 1}),
    ("ResetCommand", {"estop": 1, "source": "x", "lease": "0" * 32}),
    ("LeaseRequest", {"do": "challenge"}),
    ("LeaseRequest", {"do": "acquire", "source": "x", "proof": PROOF}),
    ("LeaseRequest", {"do": "release", "lease": "0" * 32, "to": "x"}),
    ("ButtonRequest", {"do": "register", "source": "x", "proof": PROOF, "sent_ms": 1}),
    ("ButtonRequest", {"do": "alive", "button": "0" * 32, "count": 1, "sent_ms": 1}),
]


@pytest.mark.parametrize(("name", "value"), FULL)
def test_schema_and_model_accept_the_same_with_each_value_in_each_place(name: str, value: dict[str, Any]) -> None:
    """Also with each place left out, and with one more in each object."""

    def compare() -> None:
        assert VALIDATORS[name].is_valid(value) == model_takes(name, as_json(value)), value

    def visit(inner: Any) -> None:
        for place in list(inner) if isinstance(inner, dict) else range(len(inner)):
            kept = inner[place]
            for other in VALUES:
                if isinstance(other, float) and name in ("ResetCommand", "ButtonRequest"):
                    continue  # to JSON Schema 1.0 is an integer, and the model takes integers as they are written
                inner[place] = other
                compare()
            inner[place] = kept
            if isinstance(inner, dict):
                del inner[place]
                compare()
                inner[place] = kept
            if isinstance(kept, dict | list):
                visit(kept)
        if isinstance(inner, dict):
            inner["more"] = 1
            compare()
            del inner["more"]

    value = json.loads(json.dumps(value))
    assert VALIDATORS[name].is_valid(value)
    visit(value)


@pytest.mark.parametrize(("key", "payload", "detail"), FAULTS, ids=lambda value: repr(value)[:50])
def test_what_the_intake_rejects_no_schema_accepts(key: CommandKey, payload: object, detail: str) -> None:
    """But where only the text is at fault, which no schema can see: parsed, one of two equal names is left."""
    text = payload if isinstance(payload, str) else json.dumps(payload)
    if "given twice" not in detail and not any(word in text for word in ("NaN", "Infinity")):
        assert not VALIDATORS[NAMES[key.target]].is_valid(json.loads(text))


def test_the_fullest_command_needs_less_than_a_payload_may_have() -> None:
    """In the widest way that is usual: indented, and every character of the source an escape."""
    leg = {"servos": [{"op": "start", "angle_deg": 179.99}] * 3}
    full = {"legs": {str(number): leg for number in LEGS}, "source": "😀" * 64, "sent_ms": 2.0**53}
    full["lease"] = "0" * 32
    text = json.dumps(full, indent=2)
    assert model_takes("LegsCommand", text.encode())
    assert len(text) < MAX_PAYLOAD_BYTES


# ---- what goes out


WIRE = Path(__file__).parents[1] / "data" / "wire" / "1.1"


reasons = st.sampled_from(Reason)
texts = st.text(st.characters(exclude_categories=["Cs"]))
floats = st.floats(0, 1e9)
reports: st.SearchStrategy[BaseModel] = st.one_of(
    st.builds(Ack, accepted=st.booleans(), reason=st.none() | reasons, detail=st.none() | texts,
              coalesced=st.none() | st.just(True), stop_frames=st.none() | st.integers(0),
              latency_us=st.none() | floats),
    st.builds(Event, time=st.just(NOW), kind=st.sampled_from(Kind), source=st.none() | texts, key=st.none() | texts,
              reason=st.none() | reasons, detail=texts),
    st.builds(FrameRecord, time=st.just(NOW), monotonic_ns=st.integers(0), bytes=st.binary().map(bytes.hex),
              cause=st.sampled_from(Cause)),
    st.builds(LeaseAck, accepted=st.booleans(), reason=st.none() | reasons, detail=st.none() | texts,
              nonce=st.none() | texts, lease=st.none() | texts, holder=st.none() | texts, ttl_ms=st.none() | floats,
              verified=st.none() | st.booleans()),
    st.builds(RevocationAck, accepted=st.booleans(), reason=st.none() | reasons, detail=st.none() | texts,
              number=st.none() | st.integers(0), revoked=st.none() | texts),
    st.builds(ButtonAck, accepted=st.booleans(), reason=st.none() | reasons, detail=st.none() | texts,
              nonce=st.none() | texts, button=st.none() | texts, timeout_ms=st.none() | floats,
              alive=st.none() | st.integers(0), required=st.none() | st.integers(0)),
    st.sampled_from((WIRE / "state.jsonl").read_text().splitlines()).map(StateReport.model_validate_json),
    st.sampled_from((WIRE / "config.jsonl").read_text().splitlines()).map(ConfigReport.model_validate_json),
)  # fmt: skip


@given(reports)
def test_every_report_fits_its_schema_and_comes_back_the_same(report: BaseModel) -> None:
    text = report.model_dump_json()
    VALIDATORS[type(report).__name__].validate(json.loads(text))
    assert type(report).model_validate_json(text) == report


def test_an_acknowledgement_is_true_where_the_command_was_accepted_and_raises_its_reason_otherwise() -> None:
    accepted, rejected = Ack(accepted=True), Ack(accepted=False, reason=Reason.STALE, detail="late")
    assert accepted
    assert not rejected
    assert accepted.or_raise() is accepted
    with pytest.raises(RejectedError, match="rejected: stale: late"):
        rejected.or_raise()


def test_what_carries_a_token_does_not_show_it() -> None:
    token = "0123456789abcdef" * 2
    shown = [
        LeaseAck(accepted=True, lease=token),
        LEASE_REQUEST.validate_python({"do": "renew", "lease": token}),
        ButtonAck(accepted=True, button=token),
        BUTTON_REQUEST.validate_python({"do": "leave", "button": token}),
        LEASE_REQUEST.validate_python({"do": "release", "lease": token, "to": "bert"}),
        LegCommand.model_validate({"servos": ({"op": "stop"},) * 3, "lease": token}),
    ]
    for model in shown:
        assert token not in repr(model)
        assert token not in str(model)
    with pytest.raises(ValidationError) as raised:
        LEASE_REQUEST.validate_python({"do": "renew", "lease": token, "more": token})
    assert token not in str(raised.value)


REPORTS = (
    "Ack", "LeaseAck", "RevocationAck", "ButtonAck", "Calibration", "StateReport", "ConfigReport", "Event",
    "FrameRecord", "BodyReport", "Telemetry",
)  # fmt: skip


def every_object(schema: object) -> list[dict[str, Any]]:
    if isinstance(schema, list):
        return [found for inner in schema for found in every_object(inner)]
    if not isinstance(schema, dict):
        return []
    here = [schema] if schema.get("type") == "object" else []
    return here + [found for inner in schema.values() for found in every_object(inner)]


@pytest.mark.parametrize("name", SCHEMAS)
def test_what_comes_in_is_closed_and_what_goes_out_is_open(name: str) -> None:
    Draft202012Validator.check_schema(SCHEMAS[name])
    found = every_object(SCHEMAS[name])
    assert found
    for schema in found:
        if name in REPORTS:
            assert schema.get("additionalProperties") is not False
        else:
            assert schema.get("additionalProperties") is False or "propertyNames" in schema
