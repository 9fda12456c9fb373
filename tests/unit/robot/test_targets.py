"""The table of targets: every target has its row, and an invented one behaves as its row says."""

from collections import deque
from functools import partial
from typing import cast

import pytest

from gateway.model.frames import STOP
from gateway.robot.core import targets
from gateway.robot.core.events import Command
from gateway.robot.core.intake import Rejection, deleted, read, words_of_stop
from gateway.robot.core.losses import Losses
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.targets import TARGETS, follows, servos_of, stops_of
from gateway.robot.zenoh_io.rings import Rings
from schemas import keys
from schemas.keys import COMMAND_KEYS, CommandKey, Target, leg_command, servo_command
from schemas.robot import SERVO_IDS
from schemas.telemetry import Reason
from tests.support.commands import as_json
from tests.support.reading import Intent, decode, meant

BODY = "hexapod/body/cmd"
BODY_KEY = CommandKey(cast("Target", "body"))
"""A key that somebody adds: it moves all servos."""
BODY_ROW = targets.TargetRules(lambda _: SERVO_IDS, lambda _: SERVO_IDS, lambda _number, _payload: Command(), True, 9)


def may_stop(key: str, payload: bytes, size: int | None = None) -> bool:
    size = len(payload) if size is None else size
    return words_of_stop(Received(key, key, COMMAND_KEYS[key], Verb.PUT, payload, size, "", None, 0)) is not None


def test_every_target_has_its_row() -> None:
    assert TARGETS.keys() == set(Target)


LEG_3_IDS = (31, 32, 33)
ROWS = [
    # key, the servos it may stop, those it follows, the most fields of its payload
    (keys.LEGS_COMMAND, SERVO_IDS, SERVO_IDS, 3 + 1 + 6 * (2 + 3 * 2)),
    (leg_command(3), LEG_3_IDS, LEG_3_IDS, 3 + 1 + 3 * 2),
    (servo_command(32), (32,), (32,), 3 + 2),
    (keys.ESTOP, SERVO_IDS, SERVO_IDS, 0),
    (keys.RESET, (), SERVO_IDS, 3 + 1),
]


@pytest.mark.parametrize(("key", "servos", "followed", "fields"), ROWS, ids=lambda value: str(value)[:30])
def test_what_each_row_says(key: str, servos: tuple[int, ...], followed: tuple[int, ...], fields: int) -> None:
    target = COMMAND_KEYS[key]
    assert servos_of(target) == set(servos), "without one, a message would never be done, but for a reset"
    assert follows(target) == set(followed), "an older Start on another key must not come after a Stop on this one"
    assert may_stop(key, b'{"op": "stop"}') is (key != keys.RESET), "else it would lose its place before an older start"
    assert may_stop(key, b'{"op": "\\u0073top"}') is (key != keys.RESET)
    assert may_stop(key, b'\xef\xbb\xbf{"op": "set"}') is (key != keys.RESET), "it cannot be searched for a word"
    assert may_stop(key, b"", size=4097) is (key != keys.RESET), "what it says is not known"
    assert may_stop(key, b'{"op": "set", "angle_deg": 9}') is (key == keys.ESTOP), "else a stream would be taken whole"
    stops = tuple((servo_id, STOP) for servo_id in servos)
    assert stops_of(target) == stops
    no_reset = Rejection(Reason.INVALID, "a delete does not reset; put {} on hexapod/reset/cmd")
    assert meant(deleted(target)) == (no_reset if key == keys.RESET else Intent(stops))
    for count, rejected in ((fields + 64, False), (fields + 65, True)) if fields else ():
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
    assert meant(deleted(BODY_KEY)) == Intent(tuple((servo_id, STOP) for servo_id in SERVO_IDS))
    losses = Losses()
    losses.note(BODY)
    assert dict(losses.take()[1]).keys() == set(SERVO_IDS)


def test_keys_that_share_no_servo_are_not_read_for_each_other() -> None:
    assert read_twice(servo_command(32), servo_command(33)) == [servo_command(32)]
    assert read_twice(leg_command(3), servo_command(42)) == [leg_command(3)]
    assert read_twice(leg_command(3), keys.RESET) == [leg_command(3)]
