"""The JSON Schemas say what the models say; old and later payloads are read; the state is at most 2 048 bytes."""

import json
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from pydantic import BaseModel, TypeAdapter, ValidationError

from gateway.errors import RejectedError
from schemas.__main__ import documents
from schemas.ack import Ack
from schemas.button import BUTTON_REQUEST, ButtonAck
from schemas.calibration import Calibration
from schemas.command import MAX_PAYLOAD_BYTES, SERVO_COMMAND, LegCommand, LegsCommand, ResetCommand
from schemas.config import ConfigReport
from schemas.event import Event, FrameRecord
from schemas.gateway_state import (
    ButtonsAlive,
    CommandCounts,
    ControllerReport,
    GatewayState,
    LeaseReport,
    LoopLag,
    PowerReport,
    SpiCounts,
    StopLatency,
    WatchdogCounts,
)
from schemas.keys import CommandKey, Target
from schemas.lease import LEASE_REQUEST, LeaseAck
from schemas.report import CUT
from schemas.revocation import RevocationAck
from schemas.robot import LEGS, SERVO_IDS
from schemas.state import MAX_STATE_BYTES, LegsReport, StateReport, joined
from schemas.telemetry import Battery
from schemas.words import Cause, Kind, Mode, Reason, WatchdogState
from tests.support import published
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
    st.sampled_from(published.payloads_of("1.1")["state"]).map(StateReport.model_validate_json),
    st.sampled_from(published.payloads_of("1.1")["config"]).map(ConfigReport.model_validate_json),
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


MANY = 2**53 - 1
LONG_MS = 123_456_789_012.34567
WHEN = datetime(2026, 11, 26, 22, 0, 0, 123456, UTC)


def fullest(source: str) -> StateReport:
    """Return every field as long as it can be; each leg has another source, which begins with a number."""

    def name(number: int) -> str:
        return f"{number:02}{source}"[:64]

    angles_deg = [[round(170.01 + (10 * leg + joint) / 100, 2) for joint in (1, 2, 3)] for leg in LEGS]
    legs = {
        "watchdog": [WatchdogState.EXPIRED] * 6,
        "age_ms": [round(LONG_MS, 1)] * 6,
        "angles_deg": angles_deg,
        "targets_deg": [[179.99] * 3] * 6,
        "source": range(6),
    }
    return StateReport(
        config="f" * 8,
        mode=Mode.BUS_FAULT,
        time=WHEN,
        uptime_s=LONG_MS,
        legs=LegsReport.model_validate(legs),
        sources=tuple(map(name, LEGS)),
        source_ids=tuple(f"{leg:032x}" for leg in LEGS),
        commands=CommandCounts(accepted=MANY, rejected=MANY, coalesced=MANY, overflows=MANY, lost=MANY),
        spi=SpiCounts(frames=MANY, errors=MANY),
        watchdog=WatchdogCounts(
            expirations=MANY, stop_latency_us=StopLatency(p50=98765.4321012345, p99=98765.4321012345, max=LONG_MS)
        ),
        estop=MANY,
        estop_source=name(7),
        estop_since=WHEN,
        estop_fault="/var/lib/hexapod-gateway/" + "x" * 400,
        lease=LeaseReport(holder=name(8), verified=True, held_s=LONG_MS, expires_in_ms=LONG_MS, asked_by=name(9)),
        buttons=ButtonsAlive(alive=16, names=tuple(name(number) for number in range(10, 40))),
        loop_lag_us=LoopLag(p50=98765.4321012345, p99=98765.4321012345, max=LONG_MS),
        incident="2026-11-26T22-00-00Z-" + "x" * 60,
        controller=ControllerReport(alive=False, age_ms=LONG_MS),
        battery=Battery(voltage_v=7.400000095367432, percent=80.00000190734863),
        power=PowerReport(
            interface="/dev/serial/by-id/" + "x" * 200, alive=True, supplied=SERVO_IDS, confirmed=False, age_ms=LONG_MS
        ),
    )


@given(st.text(max_size=64), st.text(max_size=400))
@example("x" * 64, "x" * 400)
@example("\N{SPIDER}" * 64, "\N{SPIDER}" * 400)
@example("\0" * 64, '"' * 400)
def test_no_text_makes_the_state_larger_than_2048_bytes_and_only_texts_are_cut(source: str, fault: str) -> None:
    whole = fullest(source).model_copy(update={"estop_fault": fault})
    state = whole.fitted()
    sent = state.model_dump_json().encode()
    assert len(sent) <= MAX_STATE_BYTES
    assert StateReport.model_validate_json(sent).model_dump_json().encode() == sent
    assert state.legs == whole.legs


def test_a_cut_name_is_still_its_sources() -> None:
    legs = joined(fullest("x" * 64).fitted(), ConfigReport.model_validate(dict(published.state()))).legs
    assert str(legs[0].source).endswith(CUT)
    name, own, other = "01" + "x" * 62, f"{1:032x}", f"{2:032x}"
    assert legs[0].is_of(name, own), "by its id, if nothing else is left"
    assert not legs[0].is_of(name, other)
    assert legs[0].model_copy(update={"source": "01x" + CUT}).is_of(name)
    assert not legs[0].is_of("02" + "x" * 62)
    assert not legs[0].model_copy(update={"source": CUT}).is_of("anna"), "a name of which nothing is left is nobody's"


MODELS: dict[str, type[BaseModel]] = {
    "ack": Ack,
    "state": StateReport,
    "config": ConfigReport,
    "event": Event,
    "frame": FrameRecord,
    "lease": LeaseAck,
    "calibration": Calibration,
    "button": ButtonAck,
}
BEFORE_CONFIG = "1.0"
"""Its states have the configuration inside, as recordings of rides do."""

RECORDED = [
    (f"{version} {name} {line}", GatewayState if (version, name) == (BEFORE_CONFIG, "state") else MODELS[name], line)
    for version in (BEFORE_CONFIG, "1.1")
    for name, lines in published.payloads_of(version).items()
    for line in lines
]


def from_the_future(value: Any) -> Any:
    """Return the same with a new field in every object, and every word that a list of known ones has changed.

    An object whose names are servos does not change, since there are no others.
    """
    if isinstance(value, list):
        return [from_the_future(inner) for inner in value]
    if not isinstance(value, dict):
        return value
    if value and all(name.isdecimal() for name in value):
        return {name: from_the_future(inner) for name, inner in value.items()}
    words = {name: f"new_{text}" for name, text in value.items() if name in _WORDS and isinstance(text, str)}
    return {name: from_the_future(inner) for name, inner in value.items()} | words | {"tomorrow": {"more": [1]}}


def contains(whole: Any, part: Any) -> bool:
    """Return whether everything in `part` stands in `whole` too."""
    if isinstance(part, dict):
        return all(name in whole and contains(whole[name], inner) for name, inner in part.items())
    if isinstance(part, list):
        return len(whole) == len(part) and all(map(contains, whole, part))
    return bool(whole == part)


_WORDS = ("kind", "mode", "reason", "cause", "watchdog")


def test_every_kind_of_payload_has_been_recorded() -> None:
    for version, missing in {BEFORE_CONFIG: {"config", "lease", "calibration", "button"}, "1.1": set[str]()}.items():
        assert published.payloads_of(version).keys() == MODELS.keys() - missing, version
    assert any('"revocations":{"number":1' in each for each in published.payloads_of("1.1")["config"])


def test_what_earlier_versions_sent_is_read_whole() -> None:
    for place, model, line in RECORDED:
        read = model.model_validate_json(line)
        assert contains(json.loads(read.model_dump_json()), json.loads(line)), place


def test_what_later_versions_may_send_is_read_and_new_words_stay_text() -> None:
    for place, model, line in RECORDED:
        later = from_the_future(json.loads(line))
        read = json.loads(model.model_validate_json(json.dumps(later)).model_dump_json())
        for word in _WORDS:
            if isinstance(later.get(word), str):
                assert read[word] == later[word], place
