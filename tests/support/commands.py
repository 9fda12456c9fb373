"""Commands to test with: legal ones made by Hypothesis, their JSON, and JSON that is no command, with its answer."""

import json
from typing import Any

from hypothesis import strategies as st

from schemas.command import MAX_SENT_MS
from schemas.keys import COMMAND_KEYS, LEGS_COMMAND, RESET, CommandKey, leg_command, servo_command
from schemas.robot import LEGS, SERVO_IDS

STOP = {"op": "stop"}
START_90 = {"op": "start", "angle_deg": 90}
LEG = {"servos": [START_90, STOP, {"op": "set", "angle_deg": 45.25}]}

angles = st.one_of(st.integers(0, 180), st.floats(0, 180), st.integers(0, 180_00).map(lambda cdeg: cdeg / 100))
moves = st.fixed_dictionaries({"op": st.sampled_from(["start", "set"]), "angle_deg": angles})
setpoints = st.one_of(st.just(STOP), moves)
legs = st.fixed_dictionaries({"servos": st.lists(setpoints, min_size=3, max_size=3)})
senders = st.fixed_dictionaries(
    {},
    optional={
        "source": st.one_of(st.none(), st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=64)),
        "sent_ms": st.one_of(st.none(), st.integers(0, MAX_SENT_MS), st.floats(0, MAX_SENT_MS)),
    },
)


def _with_sender(bodies: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    return st.builds(lambda body, sender: body | sender, bodies, senders)


servo_commands = _with_sender(setpoints)
leg_commands = _with_sender(legs)
legs_commands = _with_sender(
    st.fixed_dictionaries({"legs": st.dictionaries(st.sampled_from("123456"), legs, min_size=1)})
)

legal: st.SearchStrategy[tuple[str, dict[str, Any]]] = st.one_of(
    st.tuples(st.sampled_from([servo_command(servo_id) for servo_id in SERVO_IDS]), servo_commands),
    st.tuples(st.sampled_from([leg_command(leg) for leg in LEGS]), leg_commands),
    st.tuples(st.just(LEGS_COMMAND), legs_commands),
)
"""Keys with legal payloads for them, as dictionaries."""


def parsed(key: str) -> CommandKey:
    """Return the command key, as the inbox knows it."""
    return COMMAND_KEYS[key]


def as_json(value: object) -> bytes:
    """Return UTF-8, as a publisher sends it."""
    return json.dumps(value, ensure_ascii=False).encode()


SERVO_32, LEG_3, LEGS_KEY, RESET_KEY = (parsed(key) for key in (servo_command(32), leg_command(3), LEGS_COMMAND, RESET))


GIVEN_TWICE = "is given twice in one object; give it once"


def leg_with(third: object) -> dict[str, Any]:
    return {"servos": [STOP, STOP, third]}


ANGLE = '{"op": "start", "angle_deg": %s}'
SERVO_FAULTS: list[tuple[object, str]] = [
    # the payload as a whole
    ('"stop"', "the payload: Input should be an object"),
    # op
    ({}, "op: Field required"),
    ({"op": "STOP"}, "op: Input should be one of 'start', 'set', 'stop'"),
    # angle_deg
    ({"op": "start", "angle": 90}, "angle_deg: Field required (and 1 more)"),
    (ANGLE % "null", "angle_deg: Input should be a valid number"),
    (ANGLE % "NaN", "angle_deg: Input should be a finite number"),
    (ANGLE % "180.001", "angle_deg: Input should be less than or equal to 180"),
    # what a stop has, and has not
    ({"op": "stop", "angle_deg": 0}, "angle_deg: Extra inputs are not permitted"),
    # unknown names, also such as pydantic uses itself
    ({"op": "stop", "[key]": 1}, "the payload: Extra inputs are not permitted"),
    ({"op": "stop", "": 1}, "the payload: Extra inputs are not permitted"),
    ({"op": "stop", "a\nb\u2028": 1}, "a\\nb\\u2028: Extra inputs are not permitted"),
    ({"op": "stop", "grüße": 1}, "grüße: Extra inputs are not permitted"),
    ({"op": "stop", "k" * 4000: 1}, "kkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkkk: Extra inputs are not permitted"),
    ({"op": "stop"} | {str(n): n for n in range(50)}, "0: Extra inputs are not permitted (and 49 more)"),
    ({"op": "stop"} | {str(n): n for n in range(300)}, "the payload has more fields than any command of its key has"),
    ('{"op": "stop", "x": ' + "[" * 150 + "]" * 150 + "}", "x: Extra inputs are not permitted"),
    # who, and when
    (STOP | {"source": ""}, "source: String should have at least 1 character"),
    (STOP | {"sent_ms": -1}, "sent_ms: Input should be greater than or equal to 0"),
    # the same name twice
    ('{"op": "start", "op": "stop"}', f"op {GIVEN_TWICE}"),
    ('{"op": "set", "angle_deg": 1, "angle\\u005fdeg": 2}', f"angle_deg {GIVEN_TWICE}"),
]
LEG_FAULTS: list[tuple[object, str]] = [
    ({"servos": []}, "servos[0]: Field required (and 2 more)"),
    ({"servos": [STOP] * 4}, "servos: Array should have at most 3 items, not 4"),
    (leg_with({"op": "go"}), "servos[2].op: Input should be one of 'start', 'set', 'stop'"),
    (leg_with({"op": "set"}), "servos[2].angle_deg: Field required"),
    (LEG | {"angle_deg": 1}, "angle_deg: Extra inputs are not permitted"),
    (STOP, "servos: Field required (and 1 more)"),
]
LEGS_FAULTS: list[tuple[object, str]] = [
    ({}, "legs: Field required"),
    ({"legs": {}}, "legs: Object should have at least 1 item, not 0"),
    ({"legs": {"7": LEG}}, "legs.7: Input should be '1', '2', '3', '4', '5' or '6'"),
    (
        {"legs": {"q" * 3000: LEG}},
        "legs.qqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqqq: Input should be '1', '2', '3', '4', '5' or '6'",
    ),
    ({"legs": {"1": LEG, "4": leg_with(7)}}, "legs.4.servos[2]: Input should be an object"),
    (
        {"legs": {"4": leg_with({"op": "set", "angle_deg": -1})}},
        "legs.4.servos[2].angle_deg: Input should be greater than or equal to 0",
    ),
    ({"legs": {str(n): 1 for n in range(10, 400)}}, "the payload has more fields than any command of its key has"),
    (f'{{"legs": {{"1": {json.dumps(LEG)}, "1": {json.dumps(leg_with(STOP))}}}}}', f"1 {GIVEN_TWICE}"),
]
RESET_FAULTS: list[tuple[object, str]] = [
    ({"estop": -1}, "estop: Input should be greater than or equal to 0"),
    ({"estop": "1"}, "estop: Input should be a valid integer"),
    ({"estop": 1, "lease": "0" * 31}, "lease: String should have at least 32 characters"),
    ({"estop": 1, "lease": "F" * 32}, "lease: String should match pattern '^[0-9a-f]{32}$'"),
    ({"lesae": "ab" * 16}, "lesae: Extra inputs are not permitted"),
    ({"ab" * 16: 1}, "(hex digits): Extra inputs are not permitted"),
    ('{"estop": 1, "estop": 2}', f"estop {GIVEN_TWICE}"),
]
FAULTS: list[tuple[CommandKey, object, str]] = [
    (key, *fault)
    for key, faults in (
        (SERVO_32, SERVO_FAULTS), (LEG_3, LEG_FAULTS), (LEGS_KEY, LEGS_FAULTS), (RESET_KEY, RESET_FAULTS)
    )
    for fault in faults
]  # fmt: skip
