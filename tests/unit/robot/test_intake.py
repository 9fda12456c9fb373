"""From bytes to what somebody wants, or why not: each rule by its own sentence, and any bytes at all."""

import json
import math
from typing import Any, Final, NamedTuple

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError
from pydantic_core import SchemaValidator

from gateway.model import frames
from gateway.model.frames import STOP as STOP_OP
from gateway.model.frames import Op, ServoOp, servo_ids_of
from gateway.robot.core import intake
from gateway.robot.core.events import Command, Reset, Targets
from gateway.robot.core.flat import into_dicts
from gateway.robot.core.intake import TARGETS, follows, read, servos_of, stops_of, words_of_stop
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.rejections import Rejection, echo_of, explain
from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES, MAX_SENT_MS, LegCommand, LegsCommand
from schemas.keys import COMMAND_KEYS, ESTOP, CommandKey, Target, leg_command, servo_command
from schemas.robot import SERVO_IDS
from schemas.words import Reason
from tests.support.commands import (
    FAULTS,
    LEG,
    LEG_3,
    LEGS_KEY,
    RESET_KEY,
    SERVO_32,
    START_90,
    STOP,
    as_json,
    leg_commands,
    legal,
    legs_commands,
    parsed,
)
from tests.support.history import frames_of

# ---- a message's meaning as a value that tests compare, and a second reading of the same JSON

MAX_DETAIL: Final = 200
"""Characters of an answer to a bad command; it goes out as an event and into the log for everyone to see."""
_UNREAD: Final = frozenset({Reason.TOO_LARGE, Reason.BAD_ENCODING, Reason.MALFORMED, Reason.INVALID})


class Intent(NamedTuple):
    """A command or a reset, without how it came."""

    targets: Targets = ()
    source: str | None = None
    sent_ms: float | None = None
    estop: int | None = None
    lease: str | None = None


def meant(answer: Command | Reset | Rejection) -> Intent | Rejection:
    """Return the intent of what was read."""
    if isinstance(answer, Rejection):
        return answer
    estop = answer.estop if isinstance(answer, Reset) else None
    return Intent(answer.targets, answer.source, answer.sent_ms, estop, answer.lease)


def decode(key: CommandKey, payload: bytes, encoding: str) -> Intent | Rejection:
    """Return what a `put` of this payload asks for."""
    return meant(read(Received("", "", key, Verb.PUT, payload, len(payload), encoding, None, 0)))


def check_intake(key: CommandKey, payload: bytes, answer: object) -> None:
    """Check that an answer is an Intent true to the payload with legal frames, or a Rejection in one short line."""
    if isinstance(answer, Rejection):
        assert key.target is not Target.ESTOP
        assert answer.reason in _UNREAD
        assert 0 < len(answer.detail) <= MAX_DETAIL, answer.detail
        assert answer.detail.isprintable(), answer.detail
        return
    assert isinstance(answer, Intent)
    assert answer.source is None or 1 <= len(answer.source) <= 64
    assert answer.sent_ms is None or 0 <= answer.sent_ms <= MAX_SENT_MS
    if key.target is Target.ESTOP:
        assert answer == Intent()
        return
    sent = json.loads(payload or b"{}", object_pairs_hook=_with_every_name_once)
    assert isinstance(sent, dict)
    assert (answer.source, answer.estop) == (sent.get("source"), sent.get("estop"))
    assert (answer.sent_ms is None) == (sent.get("sent_ms") is None)
    assert answer.sent_ms is None or math.isclose(answer.sent_ms, sent["sent_ms"])
    if key.target is Target.RESET:
        assert sent.keys() <= {"estop", "source", "sent_ms"}
        assert answer.targets == ()
        return
    _check_targets(key, sent, answer.targets)
    for frame in frames_of(answer.targets):
        assert frames.decode(frame.data) == frame


def _with_every_name_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    assert len(dict(pairs)) == len(pairs), pairs
    return dict(pairs)


def _check_targets(key: CommandKey, sent: dict[str, Any], targets: Targets) -> None:
    assert sent.keys() <= {"op", "angle_deg", "servos", "legs", "source", "sent_ms"}
    match key.target:
        case Target.SERVO:
            wanted = [(key.number, sent)]
        case Target.LEG:
            wanted = list(zip(servo_ids_of(key.number), sent["servos"], strict=True))
        case _:
            assert 1 <= len(sent["legs"]) <= 6
            wanted = [
                pair
                for leg in sorted(sent["legs"])
                for pair in zip(servo_ids_of(int(leg)), sent["legs"][leg]["servos"], strict=True)
            ]
    assert [servo_id for servo_id, _ in targets] == [servo_id for servo_id, _ in wanted]
    for (_, command), (_, setpoint) in zip(targets, wanted, strict=True):
        assert command.op is {"start": Op.START, "stop": Op.STOP, "set": Op.SET}[setpoint["op"]]
        if command.op is Op.STOP:
            assert "angle_deg" not in setpoint
            continue
        angle_deg = setpoint["angle_deg"]
        assert type(angle_deg) in (int, float)
        assert 0 <= angle_deg <= 180
        assert math.isclose(command.angle_cdeg, 100 * angle_deg, rel_tol=0, abs_tol=0.5 + 1e-9)


JSON = "application/json"
ENCODINGS = (JSON, "zenoh/bytes", "", "text/plain", "application/json;charset=utf-8")


def rejection(key: CommandKey, payload: object, encoding: str = JSON) -> Rejection:
    """Return the answer to a bad command; text and bytes go as they are, anything else as JSON."""
    data = payload if isinstance(payload, bytes) else payload.encode() if isinstance(payload, str) else as_json(payload)
    answer = decode(key, data, encoding)
    assert isinstance(answer, Rejection), answer
    return answer


def servo_op(payload: str) -> ServoOp:
    answer = decode(SERVO_32, payload.encode(), JSON)
    assert isinstance(answer, Intent), answer
    ((servo_id, op),) = answer.targets
    assert servo_id == 32
    return op


# ---- what is good


@pytest.mark.parametrize("payload", [b"", b"{", b"\xff" * 5000, b'{"op": "stop"}'])
@pytest.mark.parametrize("encoding", ["", JSON, "image/png"])
def test_an_emergency_stop_is_one_whatever_it_carries(payload: bytes, encoding: str) -> None:
    assert decode(parsed(ESTOP), payload, encoding) == Intent()


@given(legal)
def test_any_legal_command_is_what_its_json_says(command: tuple[str, dict[str, Any]]) -> None:
    key, payload = command
    answer = decode(parsed(key), as_json(payload), JSON)
    assert isinstance(answer, Intent)
    check_intake(parsed(key), as_json(payload), answer)
    assert answer.source == payload.get("source")
    assert answer.sent_ms == payload.get("sent_ms")
    again = decode(parsed(key), json.dumps(payload, indent=4).encode(), "zenoh/bytes")
    assert again == answer


@pytest.mark.parametrize(
    ("angle", "cdeg"),
    [
        *(("0", 0), ("-0", 0), ("-0.0", 0), ("1e-400", 0), ("-1e-400", 0), ("0.004999", 0), ("0.005001", 1)),
        *(("90.29", 90_29), ("89.999", 90_00), ("1E2", 100_00), ("1.1e1", 11_00), ("0.29", 29), ("1.15", 1_15)),
        *(("179.994", 179_99), ("179.996", 180_00), ("180", 180_00), ("180.0", 180_00), ("180.00000000000001", 180_00)),
        ("0." + "9" * 3900, 1_00),
    ],
)
def test_angles_are_rounded_to_the_nearest_hundredth(angle: str, cdeg: int) -> None:
    assert servo_op(f'{{"op": "start", "angle_deg": {angle}}}') == ServoOp(Op.START, cdeg)


# ---- what is rejected before it is read


@pytest.mark.parametrize(
    "encoding",
    ["application/json ;x=1;y", "zenoh/bytes", "application/ld+json; profile=a", "application/json-patch+json"],
)
def test_json_by_its_other_names(encoding: str) -> None:
    assert decode(SERVO_32, as_json(STOP), encoding) == Intent(((32, STOP_OP),))


def test_the_order_of_reasons() -> None:
    """Each payload has this fault and all that follow."""
    assert rejection(SERVO_32, b"{" * 4097, "text/plain").reason is Reason.TOO_LARGE
    assert rejection(SERVO_32, b"{", "text/plain").reason is Reason.BAD_ENCODING
    assert rejection(SERVO_32, b'{"x": 1, "op": "stop"').reason is Reason.MALFORMED
    assert rejection(SERVO_32, b'{"x": 1, "op": "stop"}').reason is Reason.INVALID


# ---- what is no JSON

NOT_JSON = {
    "empty": b"",
    "cut off": b'{"op": "stop"',
    "two documents": b'{"op": "stop"} {"op": "stop"}',
    "UTF-16": '{"op": "stop"}'.encode("utf-16"),
    "a lone surrogate": b'{"op": "stop", "source": "\\ud800"}',
    "a line break in a string": b'{"op": "stop", "source": "a\nb"}',
    "deep arrays": b"[" * 4096,
}


@pytest.mark.parametrize(
    ("payload", "cause"),
    [
        (b'{"op": "set", "angle_deg": 45,5}', "45,5 has a decimal comma; write 45.5"),
        (b'\xef\xbb\xbf{"op": "stop"}', "it begins with a byte order mark; send it without"),
    ],
)
def test_the_cause_is_named_where_it_is_a_usual_one(payload: bytes, cause: str) -> None:
    assert rejection(SERVO_32, payload).detail == f"the payload is not JSON: {cause}"


@pytest.mark.parametrize("payload", NOT_JSON.values(), ids=NOT_JSON)
def test_what_is_no_json(payload: bytes) -> None:
    for key in (SERVO_32, LEG_3, LEGS_KEY, RESET_KEY):
        if key == RESET_KEY and not payload:
            continue
        answer = rejection(key, payload)
        assert answer.reason is Reason.MALFORMED
        assert answer.detail.startswith("the payload is not JSON: ")
        check_intake(key, payload, answer)


# ---- what is JSON, but no command


@pytest.mark.parametrize(("key", "payload", "detail"), FAULTS, ids=lambda value: repr(value)[:50])
def test_what_is_no_command(key: CommandKey, payload: object, detail: str) -> None:
    answer = rejection(key, payload)
    assert answer == Rejection(Reason.INVALID, detail)
    check_intake(key, b"", answer)


# ---- anything at all


@given(
    st.sampled_from(list(COMMAND_KEYS.values())),
    st.one_of(st.binary(), st.binary(max_size=5000)),
    st.sampled_from(ENCODINGS),
)
@example(LEGS_KEY, b"[" * MAX_PAYLOAD_BYTES, JSON)
def test_any_bytes_are_an_intent_or_a_rejection(key: CommandKey, payload: bytes, encoding: str) -> None:
    check_intake(key, payload, decode(key, payload, encoding))


def test_a_key_that_is_none_is_rejected_with_what_is_wrong_with_it() -> None:
    received = Received("hexapod/leg/7/cmd", "hexapod/leg/7/cmd", None, Verb.PUT, b"{}", 2, JSON, None, 0)
    assert read(received) == Rejection(Reason.INVALID, "leg 7 does not exist; legs are 1 to 6")


def test_of_a_key_of_the_senders_own_making_little_is_looked_at_and_less_repeated_and_no_token() -> None:
    token = "0123456789abcdef" * 2
    assert echo_of("x" * 101) == "x" * 100
    assert echo_of(f"{token}/" * 4) == "(hex digits)/" * 4, "none is cut in two before it is recognised"
    assert echo_of("a" * 200 + "/x") == "(hex digits)"


SENT = {"sent_ms": 1, "lease": "0" * 32}
ALL_LEGS = {"legs": {str(number): {"servos": [START_90] * 3} for number in range(1, 7)}}


@pytest.mark.parametrize(
    ("key", "command"),
    [
        *((SERVO_32, command) for command in (STOP, START_90, START_90 | SENT, STOP | {"sent_ms": None})),
        *((LEG_3, command) for command in (LEG, LEG | SENT, {"servos": [STOP] * 3})),
        *((LEGS_KEY, command) for command in (ALL_LEGS | SENT, {"legs": {"2": LEG}}, {"legs": {"2": LEG, "6": LEG}})),
    ],
    ids=repr,
)
def test_only_a_payload_with_more_colons_than_fields_is_read_twice(
    key: CommandKey, command: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    read_twice: list[bytes] = []
    monkeypatch.setattr(intake, "name_given_twice", read_twice.append)
    assert isinstance(decode(key, as_json(command | {"source": "x"}), JSON), Intent)
    assert read_twice == [] or None in command.values()
    for source in ("x:", ":" * 64):
        assert isinstance(decode(key, as_json(command | {"source": source}), JSON), Intent)
        assert read_twice.pop() == as_json(command | {"source": source})


@pytest.mark.parametrize(
    ("expression", "verb", "payload", "words"),
    [
        ("hexapod/leg/3/cmd", Verb.PUT, b'{"servos": [{"op": "set"}]}', False),
        ("hexapod/leg/3/cmd", Verb.DELETE, b"", True),
        ("hexapod/reset/cmd", Verb.PUT, b'{"source": "stop"}', False),
        ("hexapod/leg/9/cmd", Verb.PUT, b'{"op": "stop"}', False),
        ("hexapod/leg/3/cmd", Verb.PUT, b'{"servos": [{"op": "sToP"}]}', True),
        ("hexapod/leg/3/cmd", Verb.PUT, b"", False),
        ("hexapod/leg/3/cmd", Verb.PUT, b"\x1f\x8b\x08", True),
        ("hexapod/leg/3/cmd", Verb.PUT, '{"op": "set"}'.encode("utf-16-le"), True),
    ],
)
def test_what_may_be_a_stop_keeps_its_place(expression: str, verb: Verb, payload: bytes, words: bool) -> None:
    target = COMMAND_KEYS.get(expression)
    found = words_of_stop(Received(expression, expression, target, verb, payload, len(payload), JSON, None, 0))
    assert found == (payload if words else None)


# ---- The table of targets: every target has its row, and an invented one behaves as its row says


def may_stop(key: str, payload: bytes, size: int | None = None) -> bool:
    size = len(payload) if size is None else size
    return words_of_stop(Received(key, key, COMMAND_KEYS[key], Verb.PUT, payload, size, "", None, 0)) is not None


def test_every_target_has_its_row() -> None:
    assert TARGETS.keys() == set(Target)


LEG_3_IDS = (31, 32, 33)
ROWS = [
    # key, the servos it may stop, those it follows
    (keys.LEGS_COMMAND, SERVO_IDS, SERVO_IDS),
    (leg_command(3), LEG_3_IDS, LEG_3_IDS),
    (servo_command(32), (32,), (32,)),
    (keys.ESTOP, SERVO_IDS, SERVO_IDS),
    (keys.RESET, (), SERVO_IDS),
]


@pytest.mark.parametrize(("key", "servos", "followed"), ROWS, ids=lambda value: str(value)[:30])
def test_what_each_row_says(key: str, servos: tuple[int, ...], followed: tuple[int, ...]) -> None:
    target = COMMAND_KEYS[key]
    assert servos_of(target) == set(servos), "without one, a message would never be done, but for a reset"
    assert follows(target) == set(followed), "an older Start on another key must not come after a Stop on this one"
    assert may_stop(key, b'{"op": "stop"}') is (key != keys.RESET), "else it would lose its place before an older start"
    assert may_stop(key, b'{"op": "\\u0073top"}') is (key != keys.RESET)
    assert may_stop(key, b'\xef\xbb\xbf{"op": "set"}') is (key != keys.RESET), "it cannot be searched for a word"
    assert may_stop(key, b"", size=4097) is (key != keys.RESET), "what it says is not known"
    assert may_stop(key, b'{"op": "set", "angle_deg": 9}') is (key == keys.ESTOP), "else a stream would be taken whole"
    stops = tuple((servo_id, STOP_OP) for servo_id in servos)
    assert stops_of(target) == stops
    no_reset = Rejection(Reason.INVALID, "a delete does not reset; put {} on hexapod/reset/cmd")
    deleted = read(Received(key, key, target, Verb.DELETE, b"", 0, "", None, 0))
    assert meant(deleted) == (no_reset if key == keys.RESET else Intent(stops))
    for count, rejected in ((52 + 64, False), (52 + 65, True)) if key != keys.ESTOP else ():
        answer = decode(target, as_json({f"x{number}": 0 for number in range(count)}), "application/json")
        assert isinstance(answer, Rejection)
        assert (answer.detail == "the payload has more fields than any command of its key has") is rejected


@pytest.mark.parametrize("verb", [Verb.PUT, Verb.GET, Verb.DELETE])
@pytest.mark.parametrize("key", COMMAND_KEYS)
def test_a_wildcard_may_mean_any_key_but_a_reset(key: str, verb: Verb) -> None:
    target, stop = COMMAND_KEYS[key], b'{"op": "stop"}'
    exact, wild = (
        meant(read(Received(key, expression, target, verb, stop, len(stop), "", None, 0)))
        for expression in (key, "hexapod/**")
    )
    wildcard = Rejection(Reason.INVALID, "a wildcard does not reset; put {} on hexapod/reset/cmd")
    assert wild == (wildcard if key == keys.RESET else exact)
    assert wild != exact or key != keys.RESET


# ---- A payload read into dicts is what the model reads: the same values, and the same errors in the same places


READERS: dict[type[BaseModel], SchemaValidator] = {model: into_dicts(model) for model in (LegCommand, LegsCommand)}
names = st.sampled_from(["op", "angle_deg", "servos", "legs", "source", "sent_ms", "lease", "1", "6", "7", "x"])
leaves = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.sampled_from(["start", "set", "stop", "", "a" * 65, "0" * 32]),
    st.builds(dict, op=st.sampled_from(["start", "set", "stop", "hold"]), angle_deg=st.floats(-1, 181)),
)
anything = st.recursive(
    leaves, lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(names, inner, max_size=4))
)


def outcome(read: Any, payload: bytes) -> object:
    """Return the value, or each error by its place and kind, with the sentence that answers it.

    A wrong name that is given twice counts twice among dicts, and once in a model.
    """
    try:
        found = read(payload)
    except ValidationError as error:
        kinds = {(fault["loc"], fault["type"].replace("model_type", "dict_type")) for fault in error.errors()}
        return kinds, explain(error).detail.partition(" (and ")[0]
    return found.model_dump() if isinstance(found, BaseModel) else found


@pytest.mark.parametrize("model", READERS)
@given(
    payload=st.one_of(
        st.one_of(anything, leg_commands, legs_commands).map(as_json),
        st.builds(lambda whole, more: as_json(whole | more), legs_commands, st.dictionaries(names, anything)),
        st.builds(lambda whole, at: as_json(whole)[:at], leg_commands, st.integers(0, 200)),
    )
)
def test_the_model_says_the_same_of_any_payload(model: type[BaseModel], payload: bytes) -> None:
    assert outcome(READERS[model].validate_json, payload) == outcome(model.model_validate_json, payload)
