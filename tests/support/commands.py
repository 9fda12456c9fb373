"""Commands to test with: legal ones made by Hypothesis, and their JSON."""

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
    """The command key, as the inbox knows it."""
    return COMMAND_KEYS[key]


def as_json(value: object) -> bytes:
    """UTF-8, as a publisher sends it."""
    return json.dumps(value, ensure_ascii=False).encode()


SERVO_32, LEG_3, LEGS_KEY, RESET_KEY = (parsed(key) for key in (servo_command(32), leg_command(3), LEGS_COMMAND, RESET))
