"""Foreign text on one line."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.text import visible, visible_json


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Zoë drives 火星", "Zoë drives 火星"),
        ('it\'s "C:\\"\a', r"""it's "C:\"\x07"""),
        ("eve\x1b[2J\nok\r", r"eve\x1b[2J\nok\r"),
        ("\x00\x7f\x9b\u2028\ud800\U000e0001", r"\x00\x7f\x9b\u2028\ud800\U000e0001"),
    ],
)
def test_what_cannot_be_printed_is_escaped(text: str, shown: str) -> None:
    assert visible(text) == shown


@given(st.text(st.characters(exclude_categories=())))
def test_everything_can_be_printed_and_what_can_be_stays(text: str) -> None:
    assert visible(text).isprintable()
    assert visible(visible(text)) == visible(text)
    assert [char for char in text if char.isprintable()] == [char for char in text if char in visible(char)]


@given(
    st.recursive(st.none() | st.integers() | st.text(), lambda each: st.lists(each) | st.dictionaries(st.text(), each))
)
def test_json_can_be_printed_and_read_again(value: object) -> None:
    assert visible_json(value).isprintable()
    assert json.loads(visible_json(value)) == value


def test_json_keeps_what_can_be_printed_and_has_words_for_other_objects() -> None:
    assert visible_json({"Zoë": 1j}) == '{"Zoë": "1j"}'
