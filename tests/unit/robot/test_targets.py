"""The table of targets: every target has its row, and an invented one behaves as its row says."""

from collections import deque
from functools import partial
from typing import cast

import pytest

from gateway.robot.core import targets
from gateway.robot.core.intake import deleted
from gateway.robot.core.losses import Losses
from gateway.robot.core.targets import TARGETS, Intent, follows, servos_of
from gateway.robot.edge.rings import Rings
from gateway.robot.protocol.frames import STOP
from schemas import keys
from schemas.keys import COMMAND_KEYS, CommandKey, Target, leg_command, servo_command
from schemas.robot import SERVO_IDS

BODY = "hexapod/body/cmd"
BODY_KEY = CommandKey(cast("Target", "body"))
"""A key that somebody adds: it moves all servos."""
BODY_ROW = targets.Row(lambda _: SERVO_IDS, lambda _: SERVO_IDS, lambda _number, _payload: Intent(), 9)


def test_every_target_has_its_row() -> None:
    assert TARGETS.keys() == set(Target)


def test_only_a_reset_names_no_servos() -> None:
    """Any other message becomes a Command, which is done when each of its servos is: without one, never."""
    assert [key for key in COMMAND_KEYS if not servos_of(COMMAND_KEYS[key])] == [keys.RESET]


@pytest.mark.parametrize("key", COMMAND_KEYS.values(), ids=str)
def test_a_key_follows_at_least_what_it_may_stop(key: CommandKey) -> None:
    assert servos_of(key) <= follows(key), "an older Start on another key would come after a Stop on this one"


def read_twice(first: str, second: str) -> list[str]:
    """Whose messages one `read` finds, where the message on `second` arrives when `first` has been read."""
    waiting = {key: deque[str]() for key in COMMAND_KEYS}
    waiting[first].append("stop")

    def receive(key: str) -> str | None:
        if not waiting[key]:
            return None
        if key == first:
            waiting[second].append("start")
        return waiting[key].popleft()

    each = Rings[str, str](
        {key: (partial(receive, key), lambda: None) for key in COMMAND_KEYS},
        lambda _, item: item,
        lambda item: b"" if item == "stop" else None,
    )
    return [key for key, _ in each.read((first,))]


@pytest.mark.parametrize("other", [keys.LEGS_COMMAND, leg_command(3), servo_command(32)])
def test_an_invented_key_overtakes_no_stop_and_its_delete_stops_what_it_names(
    other: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(COMMAND_KEYS, BODY, BODY_KEY)
    with pytest.raises(KeyError, match="body"):  # without its row, no gateway starts
        read_twice(BODY, other)
    monkeypatch.setitem(TARGETS, BODY_KEY.target, BODY_ROW)
    assert set(read_twice(BODY, other)) == set(read_twice(other, BODY)) == {BODY, other}
    assert deleted(BODY_KEY) == Intent(tuple((servo_id, STOP) for servo_id in SERVO_IDS))
    losses = Losses()
    losses.note(BODY)
    assert dict(losses.take()[1]).keys() == set(SERVO_IDS)


def test_keys_that_share_no_servo_are_not_read_for_each_other() -> None:
    assert read_twice(servo_command(32), servo_command(33)) == [servo_command(32)]
    assert read_twice(leg_command(3), servo_command(42)) == [leg_command(3)]
    assert read_twice(leg_command(3), keys.RESET) == [leg_command(3)]
