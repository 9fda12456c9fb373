"""Foreign text on one line."""

import pytest

from gateway.text import decimal_comma, visible


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


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('{"op":"set","angle_deg":45,5}', "45,5 has a decimal comma; write 45.5"),
        ('{"a": -0,25, "b": 1}', "-0,25 has a decimal comma; write -0.25"),
        ("[watchdog]\ntimeout_ms = 250,5\nscope = 1\n", "250,5 has a decimal comma; write 250.5"),
        ("min_deg = -1,5  # less", "-1,5 has a decimal comma; write -1.5"),
        ('{"a":[45,5]}', ""),
        ("servos = [45,5]", ""),
        ('{"a":45,"b":5}', ""),
        ('{"source":"at 45,5"', ""),
    ],
)
def test_a_decimal_comma_is_named(text: str, sentence: str) -> None:
    assert decimal_comma(text) == sentence
