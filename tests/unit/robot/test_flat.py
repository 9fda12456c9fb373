"""A payload read into dicts is what the model reads: the same values, and the same errors in the same places."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, RootModel, ValidationError, computed_field, model_validator
from pydantic_core import SchemaValidator

from gateway.robot.core.flat import into_dicts
from gateway.robot.core.intake import explain
from schemas.command import LegCommand, LegsCommand
from tests.support.bad_commands import FAULTS
from tests.support.commands import as_json, leg_commands, legs_commands

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
