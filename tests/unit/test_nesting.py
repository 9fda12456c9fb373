"""Files that nest without end, or are too large, are a sentence before anything parses them."""

import json

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
    "text",
    [
        "[" * MOST_LEVELS + "]" * MOST_LEVELS,
        "[[]," * 50 + "]" * 50,
        json.dumps(["[" * 1000, "a\\", '"[' * 500]),
        f"// {'[' * 1000}\n/* {'{' * 1000} */ []",
        "[]," * 10_000,
        "/*" * 400_000,  # not in quadratic time
        '"a\\' * 300_000,
    ],
)
def test_json5_that_does_not(text: str) -> None:
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
    ],
)
def test_toml_that_is_none_of_ours(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        nesting.read_toml(text.encode())


def test_toml_that_is_taken() -> None:
    assert nesting.read_toml(b"a.b = [1, {c = 2}]\n") == {"a": {"b": [1, {"c": 2}]}}
    with pytest.raises(ValueError, match="is not TOML: 'utf-8'"):
        nesting.read_toml(b"\xff")
    deep = "a" + ".a" * (MOST_LEVELS - 2) + "=1"
    assert nesting.read_toml(deep.encode())
