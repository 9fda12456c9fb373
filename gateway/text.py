"""Foreign text on one line: it must neither control a terminal nor look like further lines."""

import json


def visible(text: str) -> str:
    """The text with Python's escapes for unprintable characters: `\\n`, `\\x1b`, `\\u2028`."""
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def visible_json(value: object) -> str:
    """The value as JSON; in ASCII if a character is unprintable. Other types become their `str`."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if text.isprintable() else json.dumps(value, default=str)
