"""What is rejected for its form and may contain a Stop stops all servos of its key; else, those that it names."""

import asyncio
import gzip
import json
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.model.frames import Op
from gateway.robot.core.intake import servos_of, stops_in
from gateway.robot.core.message import Received, Verb
from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.keys import COMMAND_KEYS
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Kind, Reason
from tests.support.robot import LEG_3, Robot, leg, started_and_quiet

# ---- Stops as other programs write them, none of which is a valid command

JSON: Final = "application/json"


class Form(NamedTuple):
    """A payload that may contain a Stop, and why it is rejected."""

    payload: bytes
    reason: Reason
    encoding: str = JSON


def _text(value: Any) -> bytes:
    return json.dumps(value).encode()


def _forms(setpoint: Callable[..., dict[str, Any]]) -> dict[str, Form]:
    """Return the forms of a command that stops. `setpoint(stop, **more)` makes it with this Stop for each servo."""
    plain = _text(setpoint({"op": "stop"}))
    bare = plain.decode()
    invalid = {
        "null angle": setpoint({"op": "stop", "angle_deg": None}),
        "upper case": setpoint({"op": "STOP"}),
        "enum": setpoint({"op": "OP_STOP"}),
        "unknown field": setpoint({"op": "stop"}, comment="x"),
        "long source": setpoint({"op": "stop"}, source="x" * 70),
        "list": [setpoint({"op": "stop"})],
        "envelope": {"command": setpoint({"op": "stop"})},
        "many fields": setpoint({"op": "stop"}, **{f"x{number}": 0 for number in range(300)}),
    }
    made = {name: Form(_text(value), Reason.INVALID) for name, value in invalid.items()}
    malformed = {
        "NUL behind it": plain + b"\0",
        "byte order mark": b"\xef\xbb\xbf" + plain,
        "UTF-16": bare.encode("utf-16"),
        "UTF-16 that begins like JSON": bare.encode("utf-16-le"),
        "single quotes": bare.replace('"', "'").encode(),
        "word": b"stop",
        "gzip": gzip.compress(plain, mtime=0),
        "deep": b'{"x":' + b"[" * 2000 + plain,
    }
    made |= {name: Form(payload, Reason.MALFORMED) for name, payload in malformed.items()}
    twice = bare.replace('"op": "stop"', '"op": "stop", "op": "start", "angle_deg": 9').encode()
    made["given twice"] = Form(twice, Reason.INVALID)
    upper = plain.upper().replace(b'"OP"', b'"op"').replace(b'"SERVOS"', b'"servos"').replace(b'"LEGS"', b'"legs"')
    made["escaped"] = Form(upper.replace(b"STOP", b"\\u0053TOP"), Reason.INVALID)
    made |= {encoding: Form(plain, Reason.BAD_ENCODING, encoding) for encoding in ("text/plain", "APPLICATION/JSON")}
    too_large = b" " * (MAX_PAYLOAD_BYTES + 1 - len(plain)) + plain
    made["too large"] = Form(too_large, Reason.TOO_LARGE)
    made["not plain, and in a foreign encoding"] = Form(_text(invalid["null angle"]), Reason.BAD_ENCODING, "text/plain")
    return made


SETPOINTS: Final[dict[str, Callable[..., dict[str, Any]]]] = {
    "hexapod/leg/3/cmd": lambda stop, **more: {"servos": [stop] * 3, **more},
    "hexapod/servo/32/cmd": lambda stop, **more: {**stop, **more},
    "hexapod/legs/cmd": lambda stop, **more: {"legs": {"3": {"servos": [stop] * 3}}, **more},
}
FORMS: Final = {
    f"{key}: {name}": (key, form) for key, setpoint in SETPOINTS.items() for name, form in _forms(setpoint).items()
}
"""By name: the key, and the form of a Stop for servo 32 among others."""

STOP, SET = {"op": "stop"}, {"op": "set", "angle_deg": 80}
"""A Stop that is rejected for its form."""


async def running(**sections: Any) -> Robot:
    """Return a robot of which all servos run, and nothing is recorded yet."""
    robot = await started_and_quiet(**sections)
    assert robot.ask(keys.LEGS_COMMAND, {"legs": {str(number): leg("start", 90, 90, 90) for number in LEGS}}).accepted
    await asyncio.sleep(0.06)
    robot.controller.transfers.clear()
    robot.reports.clear()
    return robot


def stopped(robot: Robot) -> set[int]:
    return set(SERVO_IDS) - robot.controller.energised


def named(payload: object, key: str) -> set[int]:
    """Return the servos that a rejected payload stops."""
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    received = Received(key, key, COMMAND_KEYS.get(key), Verb.PUT, data, len(data), JSON, None, 0)
    return {servo_id for servo_id, op in stops_in(received) if op.op is Op.STOP}


# ---- forms


@pytest.mark.virtual_time
@pytest.mark.parametrize("verb", [Verb.PUT, Verb.GET])
@pytest.mark.parametrize(("key", "form"), FORMS.values(), ids=FORMS)
async def test_a_stop_is_a_stop_in_whatever_form(key: str, form: Form, verb: Verb) -> None:
    robot = await running()
    source = "d00d" if verb is Verb.PUT else None
    size = len(form.payload)
    payload = form.payload if size <= MAX_PAYLOAD_BYTES else b""  # as the inbox hands it over
    more: dict[str, Any] = {"encoding": form.encoding, "source": source, "size": size}
    if verb is Verb.PUT:
        robot.put(key, payload, **more)
    else:
        ack = robot.ask(key, payload, **more)
        assert (ack.accepted, ack.reason, ack.stopped, ack.written) == (False, form.reason, True, None)
        assert ack.detail
    assert stopped(robot) == servos_of(COMMAND_KEYS[key])
    (rejection,) = robot.events(Kind.COMMAND_REJECTED)
    assert (rejection.reason, rejection.key, rejection.source, rejection.legs) == (form.reason, key, source, ())
    assert robot.state().commands.rejected == 1
    first = len(robot.frames)
    await asyncio.sleep(0.1)
    assert len(robot.frames) > first, "it is repeated like any Stop"


@pytest.mark.virtual_time
@pytest.mark.parametrize(
    ("payload", "more"),
    [
        (leg("set", 80, 80, 190), {}),
        (leg("set", 80, 80, 190, source="nonstop"), {}),
        (leg("set", 80, 80, 190, source="a\\b"), {}),
        (leg("set", 80, 80, 80), {"encoding": "text/plain"}),
        (b"", {}),
        (b'{"servos": [', {}),
    ],
    ids=repr,
)
async def test_what_names_no_stop_stops_nothing(payload: object, more: dict[str, Any]) -> None:
    """An empty payload is what `get hexapod/**` sends, from whoever lists what there is."""
    robot = await running()
    ack = robot.ask(LEG_3, payload, **more)
    assert (ack.accepted, ack.stopped) == (False, None)
    assert (stopped(robot), robot.frames) == (set(), [])


ODD = {"op": "Stop"}
MENTIONED: list[tuple[str, object, bool]] = [
    (LEG_3, {"servos": [ODD, SET, SET]}, True),
    (LEG_3, {"servos": [STOP, SET, SET, SET]}, True),
    (LEG_3, {"servos": [SET, SET, {"op": "set", "angle_deg": 9, "x": ["stop"]}]}, True),
    (LEG_3, {"servos": [SET, SET, {"op": "set", "angle_deg": 999}], "source": "stop"}, False),
    (LEG_3, {"servos": [SET, SET, {"op": "set", "angle_deg": 999}], "source": {"op": "stop"}}, True),
    (LEG_3, {"servos": [{"op": "\u017ftop"}, SET, SET]}, True),  # its capital letters are STOP
    (LEG_3, b'{"servos": [{"op": "stop", "op": "set"}, {}, {}]}', True),
    (LEG_3, b'{"servos": [{"op": "st\\u006fp"}, {"op": "set"}, {}]}', True),
    (LEG_3, b'{"servos": [{"op": "st\\x6fp"}, {"op": "set"}, {}]}', True),
    (LEG_3, _text({"servos": [ODD, SET, SET]}).ljust(MAX_PAYLOAD_BYTES), True),
    (keys.LEGS_COMMAND, {"legs": {"3": ODD, "5": {"servos": [SET] * 3}}}, True),
    (keys.servo_command(32), {"op": "set", "angle_deg": 999, "source": "stop"}, False),
    (keys.servo_command(32), {"op": "set", "angle_deg": 999, "stop": 1}, True),
    (keys.RESET, {"op": "stop"}, False),
    ("hexapod/leg/9/cmd", {"op": "stop"}, False),
]


@pytest.mark.parametrize(("key", "payload", "stops"), MENTIONED, ids=repr)
def test_a_rejected_payload_that_mentions_a_stop_stops_all_servos_of_its_key(
    key: str, payload: object, stops: bool
) -> None:
    assert named(payload, key) == (servos_of(COMMAND_KEYS[key]) if stops else set())


json_values = st.recursive(
    st.one_of(st.none(), st.integers(), st.sampled_from(["stop", "STOP", "x", "op"])),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.sampled_from(["op", "servos", "legs", "1", "3", "x"]), inner, max_size=4),
    ),
    max_leaves=12,
)


@given(json_values, st.sampled_from([keys.LEGS_COMMAND, LEG_3, keys.servo_command(32)]))
def test_a_payload_that_mentions_a_stop_anywhere_stops_its_key_and_no_other_does(payload: object, key: str) -> None:
    stops = "stop" in json.dumps(payload).lower()
    assert named(payload, key) == (servos_of(COMMAND_KEYS[key]) if stops else set())


@given(st.binary(max_size=300), st.sampled_from(sorted(COMMAND_KEYS)))
def test_any_bytes_are_judged(payload: bytes, key: str) -> None:
    assert named(payload, key) <= set(SERVO_IDS)


# ---- rejected for another reason than the form


@pytest.mark.virtual_time
@pytest.mark.parametrize("verb", [Verb.PUT, Verb.GET])
async def test_the_stops_of_a_stale_command_come(verb: Verb) -> None:
    robot = await running()
    robot.put(LEG_3, leg("set", 90, 90, 90, source="bert", sent_ms=1000))
    await asyncio.sleep(0.15)
    robot.put(LEG_3, leg("set", 90, 90, 90, source="bert", sent_ms=1150))
    late = {"servos": [STOP, SET, SET], "source": "bert", "sent_ms": 300}
    if verb is Verb.PUT:
        robot.put(LEG_3, late)
    else:
        ack = robot.ask(LEG_3, late)
        assert (ack.accepted, ack.reason, ack.stopped, ack.written) == (False, Reason.STALE, True, None)
    assert stopped(robot) == {31}
    (rejection,) = robot.events(Kind.COMMAND_REJECTED)
    assert (rejection.reason, rejection.legs) == (Reason.STALE, (3,))


@pytest.mark.virtual_time
@pytest.mark.parametrize("verb", [Verb.PUT, Verb.GET])
async def test_a_rejected_stop_does_not_feed_the_watchdog_and_a_later_start_of_its_channel_starts(verb: Verb) -> None:
    robot = await running()
    await asyncio.sleep(0.2)
    robot.put(LEG_3, {"servos": [ODD, SET, SET]})
    robot.put_later(LEG_3, {"servos": [ODD] * 3}, verb=verb)
    robot.put(LEG_3, leg("start", 10, 10, 10), verb=verb)
    await asyncio.sleep(0.1)
    assert stopped(robot) == set(SERVO_IDS) - {31, 32, 33}, "the others fell silent"
