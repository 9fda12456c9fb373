"""The table of targets: every target has its row, and an invented one behaves as its row says."""

from collections import deque
from functools import partial
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, RootModel, ValidationError, computed_field, model_validator
from pydantic_core import SchemaValidator

from gateway.model.frames import STOP
from gateway.robot.core import targets
from gateway.robot.core.events import Command
from gateway.robot.core.flat import into_dicts
from gateway.robot.core.intake import Rejection, deleted, explain, read, words_of_stop
from gateway.robot.core.losses import Losses
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.targets import TARGETS, follows, servos_of, stops_of
from gateway.robot.zenoh_io.rings import Rings
from schemas import keys
from schemas.command import LegCommand, LegsCommand
from schemas.keys import COMMAND_KEYS, CommandKey, Target, leg_command, servo_command
from schemas.robot import SERVO_IDS
from schemas.telemetry import Reason
from tests.support.bad_commands import FAULTS
from tests.support.commands import as_json, leg_commands, legs_commands
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
    """The value, or each error by its place and kind, with the sentence that answers it.

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


@pytest.mark.parametrize("model", READERS)
def test_the_model_says_the_same_of_what_is_wrong(model: type[BaseModel]) -> None:
    for _key, payload, _sentence in FAULTS:
        data = (
            payload
            if isinstance(payload, bytes)
            else payload.encode()
            if isinstance(payload, str)
            else as_json(payload)
        )
        assert outcome(READERS[model].validate_json, data) == outcome(model.model_validate_json, data)


class Checked(LegCommand):
    @model_validator(mode="after")
    def check(self) -> "Checked":
        return self


class Computed(LegCommand):
    @computed_field
    def legs(self) -> int:
        return 6


class Numbers(RootModel[list[int]]):
    model_config = ConfigDict(strict=True)


@pytest.mark.parametrize("model", [Checked, Computed, Numbers])
def test_a_model_that_is_more_than_its_fields_is_not_read_so(model: type[BaseModel]) -> None:
    with pytest.raises(ValueError, match=r"expects the model|more than its fields"):
        into_dicts(model)
