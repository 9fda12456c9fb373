"""Files that nest without end, or are too large, are a sentence before anything parses them."""

import pytest

from gateway import nesting
from gateway.nesting import MOST_BYTES, MOST_DOTS, MOST_LEVELS

DEEP = MOST_LEVELS + 1


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "{a:" * DEEP,
        '["]",' * DEEP,
        "['}}}'," * DEEP,
        "[/*]*/" * DEEP,
        "[//]\n" * DEEP,
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
        ("[a" + ".a" * 100_000 + "]", f"a line with more than {MOST_DOTS} dots"),
        ("a" + ".a" * MOST_LEVELS + "=1", "nests deeper"),
        ("a=" + "[" * DEEP + "]" * DEEP, "nests deeper"),
        ("a=" + "[" * 100_000, "nests deeper"),
        ("a=" + "{b=" * 100_000, "nests deeper"),
        ("#" * (MOST_BYTES + 1), f"more than {MOST_BYTES} bytes"),
        ("a = ", "is not TOML: "),
        ("a = 4,5", "is not TOML: 4,5 has a decimal comma; write 4.5"),
    ],
)
def test_toml_that_is_none_of_ours(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        nesting.read_toml(text.encode())


def test_toml_with_a_byte_order_mark() -> None:
    assert nesting.read_toml(b"\xef\xbb\xbf[spi]\nspeed_hz = 1\n") == {"spi": {"speed_hz": 1}}
