"""Text for people. Foreign text stays on one line: it must neither control a terminal nor look like further lines."""

import json
import re
from collections.abc import Collection
from typing import Final

from schemas.robot import LEGS

MAX_ECHO: Final = 80


def visible(text: str) -> str:
    """Return the text with Python's escapes for unprintable characters: `\\n`, `\\x1b`, `\\u2028`."""
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def visible_json(value: object) -> str:
    """Return the value as JSON; in ASCII if a character is unprintable. Other types become their `str`."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if text.isprintable() else json.dumps(value, default=str)


def echo(value: object) -> str:
    """Return the value as JSON, cut to `MAX_ECHO` characters."""
    text = visible_json(value)
    return text if len(text) <= MAX_ECHO else text[:MAX_ECHO] + "…"


def key_name(name: str) -> str:
    """Return the name, if it can be a bare key of TOML; else quoted."""
    return name if re.fullmatch(r"[\w-]{1,80}", name, re.ASCII) else echo(name)


def legs_named(legs: Collection[int]) -> str:
    """`leg 3`, `legs 1, 3 and 4`, `all legs`."""
    *first, last = [str(leg) for leg in sorted(legs)]
    return "all legs" if len(legs) == len(LEGS) else f"legs {', '.join(first)} and {last}" if first else f"leg {last}"


BOM: Final = "\ufeff"
_DECIMAL_COMMA: Final = re.compile(r"[:=]\s*(-?\d{1,9}),(\d{1,9})\s*(?:[,}\]#]|$)", re.MULTILINE)


def decimal_comma(text: str) -> str:
    """Return a sentence about the first number of JSON or TOML with a decimal comma; "": none has one."""
    found = _DECIMAL_COMMA.search(text)
    return f"{found[1]},{found[2]} has a decimal comma; write {found[1]}.{found[2]}" if found else ""
