"""Checks the size and nesting of files before they are parsed.

Zenoh's parser of JSON5 ends the process by SIGSEGV for 100 000 brackets. Python's of TOML takes 29 s for a key of
20 000 parts, whose value then exceeds the recursion limit.
"""

import re
import tomllib
from typing import Any, Final

from gateway.words.text import decimal_comma

MOST_LEVELS: Final = 100
"""gateway.json5 has 6."""
MOST_BYTES: Final = 1_000_000
"""Far more than any Zenoh file needs: one with rules for a hundred robots had some 200 000."""
MOST_DOTS: Final = 1000
"""Most parts of a key in TOML; such a key takes 50 ms."""

NO_TEXT: Final = "is no text in UTF-8: saved in another encoding (UTF-16), or damaged by a power cut"
_TOO_DEEP: Final = f"nests deeper than {MOST_LEVELS} levels"
_APART: Final = re.compile(
    rb'"(?:[^"\\]|\\.?)*+(?:"|\Z)'  # text and comments, perhaps without an end: brackets in them do not count
    rb"|'(?:[^'\\]|\\.?)*+(?:'|\Z)"
    rb"|//[^\n]*+"
    rb"|/\*.*?(?:\*/|\Z)"
    rb"|[\[{]"
    rb"|[\]}]",
    re.DOTALL,
)


def check(data: bytes) -> None:
    """Raises ValueError with one sentence if JSON5 (or JSON) is too large or nested too deep."""
    _check_size(data)
    level = 0
    for found in _APART.finditer(data):
        level += (found[0] in b"[{") - (found[0] in b"]}")
        if level > MOST_LEVELS:
            raise ValueError(_TOO_DEEP)


def read_toml(data: bytes) -> dict[str, Any]:
    """Return the values of TOML, also with a byte order mark. Raises ValueError with one sentence."""
    _check_size(data)
    if any(line.count(b".") > MOST_DOTS for line in data.splitlines()):
        raise ValueError(f"has a line with more than {MOST_DOTS} dots")
    if b"\0" in data:
        raise ValueError(NO_TEXT)
    try:
        values = tomllib.loads(data.decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError(NO_TEXT) from None
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except ValueError as error:
        cause = decimal_comma(data.decode())
        raise ValueError(f"is not TOML: {cause or error}") from error
    level: list[Any] = [values]
    for _ in range(MOST_LEVELS):
        tables = (each.values() if isinstance(each, dict) else each for each in level if isinstance(each, dict | list))
        level = [below for table in tables for below in table]
    if level:
        raise ValueError(_TOO_DEEP)
    return values


def _check_size(data: bytes) -> None:
    if len(data) > MOST_BYTES:
        raise ValueError(f"has more than {MOST_BYTES} bytes")
