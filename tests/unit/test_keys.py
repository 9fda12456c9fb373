"""The keys are the contract's, and what is none of them is answered in one short line."""

import re

import pytest

from schemas.keys import COMMAND_KEYS, CommandKey, Target, leg_command, parse, servo_command
from schemas.robot import LEGS, SERVO_IDS


def test_commands_of_one_instant_apply_in_this_order() -> None:
    targets = [parsed.target for parsed in COMMAND_KEYS.values()]
    assert targets == [Target.LEGS, *[Target.LEG] * 6, *[Target.SERVO] * 18, Target.ESTOP, Target.RESET]


def test_what_is_built_is_parsed() -> None:
    for leg in LEGS:
        assert parse(leg_command(leg)) == CommandKey(Target.LEG, leg)
    for servo_id in SERVO_IDS:
        assert parse(servo_command(servo_id)) == CommandKey(Target.SERVO, servo_id)


NO_LEG = "does not exist; legs are 1 to 6"
NO_SERVO = "does not exist; an id is the leg (1 to 6) and the joint (1 to 3), such as 32"
NO_KEY = "is no command key; they are leg/1..6, servo/11..63, legs, estop and reset"


@pytest.mark.parametrize(("leg", "servo_id"), [(-1, -11), (0, 0), (7, 71), (11, 14), (64, 64)])
def test_no_key_for_a_leg_or_a_servo_that_is_none(leg: int, servo_id: int) -> None:
    with pytest.raises(ValueError, match=f"^leg {leg} {NO_LEG}$"):
        leg_command(leg)
    with pytest.raises(ValueError, match=f"^servo {servo_id} {re.escape(NO_SERVO)}"):
        servo_command(servo_id)


@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("hexapod/leg/01/cmd", f"leg 01 {NO_LEG}"),
        ("hexapod/servo/14/cmd", f"servo 14 {NO_SERVO}"),
        ("hexapod/leg/1/2/cmd", f"hexapod/leg/1/2/cmd {NO_KEY}"),
        ("", f'"" {NO_KEY}'),
        ("hexapod/leg/a\nb/cmd", rf'leg "a\nb" {NO_LEG}'),
        (f"hexapod/servo/{'9' * 999}/cmd", f"servo {'9' * 60}… {NO_SERVO}"),
        ("hexapod/\x1b[2J/cmd", rf'"hexapod/\u001b[2J/cmd" {NO_KEY}'),
    ],
)
def test_what_is_no_command_key(key: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(sentence)}$"):
        parse(key)
