"""Foreign text: on one line, with decimal commas, and files that nest without end or are too large."""

import pytest

from gateway.files import nesting
from gateway.files.nesting import MOST_BYTES, MOST_DOTS, MOST_LEVELS
from gateway.words.text import decimal_comma, visible


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
        ("[watchdog]\ntimeout_ms = 250,5\nscope = 1\n", "250,5 has a decimal comma; write 250.5"),
        ("min_deg = -1,5  # less", "-1,5 has a decimal comma; write -1.5"),
        ('{"a":[45,5]}', ""),
        ('{"a":45,"b":5}', ""),
        ('{"source":"at 45,5"', ""),
    ],
)
def test_a_decimal_comma_is_named(text: str, sentence: str) -> None:
    assert decimal_comma(text) == sentence


# ---- before anything parses them


DEEP = MOST_LEVELS + 1


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "[/*]*/" * DEEP,
        r'["\"]",' * DEEP,
        '{"a":[' * DEEP,
    ],
)
def test_json5_that_nests_without_end(text: str) -> None:
    with pytest.raises(ValueError, match="nests deeper than 100 levels"):
        nesting.check(text.encode())


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a" + ".a" * 100_000 + "=1", f"a line with more than {MOST_DOTS} dots"),
        ("a" + ".a" * MOST_LEVELS + "=1", "nests deeper"),
        ("a=" + "[" * DEEP + "]" * DEEP, "nests deeper"),
        ("#" * (MOST_BYTES + 1), f"more than {MOST_BYTES} bytes"),
        ("a = ", "is not TOML: "),
    ],
)
def test_toml_that_is_none_of_ours(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        nesting.read_toml(text.encode())


def test_toml_with_a_byte_order_mark() -> None:
    assert nesting.read_toml(b"\xef\xbb\xbf[spi]\nspeed_hz = 1\n") == {"spi": {"speed_hz": 1}}
