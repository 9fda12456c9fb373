"""Why a payload is rejected, in a sentence for its sender. No sentence repeats a value, which may be a secret. Pure."""

import json
import re
from typing import Final, final, get_args

from pydantic import ValidationError

from gateway.robot.core.message import value
from gateway.words.text import BOM, decimal_comma, visible
from schemas.button import ButtonRequest
from schemas.command import MAX_PAYLOAD_BYTES, ServoSetpoint
from schemas.lease import LeaseRequest
from schemas.words import Reason

MAX_KEY: Final = 100
"""Characters of an unknown key that an event repeats; ours have at most 20."""
_MAX_NAME: Final = 40
"""Characters of a sender's name that a rejection repeats."""
_SECRET: Final = re.compile(r"[0-9a-fA-F]{32,}")
"""Text that may be a lease's token in the wrong field."""
_KINDS: Final[frozenset[object]] = frozenset(
    kind
    for models, union in map(get_args, (ServoSetpoint, LeaseRequest, ButtonRequest))
    for model in get_args(models)
    for kind in get_args(model.model_fields[union.discriminator].annotation)
)
"""The kinds of commands and requests, such as "start", which pydantic puts before the fields of one."""
_WORDS: Final = {"Tuple": "Array", "Dictionary": "Object", " after validation": ""}


@final
@value
class Rejection:
    """The reason for rejecting a command, and a sentence for its sender."""

    reason: Reason
    detail: str


BAD_ENCODING: Final = Rejection(Reason.BAD_ENCODING, "the encoding must be application/json, or left out")
TOO_MANY_FIELDS: Final = Rejection(Reason.INVALID, "the payload has more fields than any command of its key has")


def echo_of(key: str) -> str:
    """Return an unknown key for an event: at most `MAX_KEY` characters, without secrets."""
    return _SECRET.sub("(hex digits)", key[: 2 * MAX_KEY])[:MAX_KEY]


def too_large(size: int, most: int = MAX_PAYLOAD_BYTES) -> Rejection:
    """Return the rejection of a payload of `size` bytes, more than the `most` that are read."""
    return Rejection(Reason.TOO_LARGE, f"the payload has {size} bytes; at most {most} are read")


class _GivenTwiceError(ValueError):
    """An object of the payload has a name twice; the text is the name."""


def name_given_twice(payload: bytes) -> Rejection | None:
    """Return the rejection of this valid payload if one of its objects has a name twice, or None.

    pydantic silently keeps the last value, but the sender may have meant the other one.
    """
    try:
        json.loads(payload, object_pairs_hook=each_name_once)
    except _GivenTwiceError as error:
        return Rejection(Reason.INVALID, f"{_name(str(error))} is given twice in one object; give it once")
    return None


def each_name_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Make a JSON object. Raises ValueError if a name is given twice."""
    found: dict[str, object] = {}
    for name, each in pairs:
        if name in found:
            raise _GivenTwiceError(name)
        found[name] = each
    return found


def explain(error: ValidationError) -> Rejection:
    """Return the rejection of an invalid payload, in a sentence that names the field and what it must be."""
    first, *others = error.errors()
    ctx = first.get("ctx", {})
    if first["type"] == "json_invalid":
        payload: str | bytes = first["input"]
        text = payload if isinstance(payload, str) else payload.decode(errors="replace")
        cause = "it begins with a byte order mark; send it without" if text.startswith(BOM) else decimal_comma(text)
        return Rejection(Reason.MALFORMED, f"the payload is not JSON: {cause or ctx['error']}")
    where, must = first["loc"], first["msg"]
    if "discriminator" in ctx:  # pydantic's own sentence repeats the value
        where = (*where, ctx["discriminator"].strip("'"))
        must = f"Input should be one of {ctx['expected_tags']}" if "expected_tags" in ctx else "Field required"
    fields = [part for part in where[:-1] if part not in _KINDS]
    fields += [part for part in where[-1:] if part != "[key]"]
    path = "".join(f"[{part}]" if isinstance(part, int) else f".{_name(part)}" for part in fields).removeprefix(".")
    for word, of_json in _WORDS.items():
        must = must.replace(word, of_json)
    more = f" (and {len(others)} more)" if others else ""
    return Rejection(Reason.INVALID, f"{path or 'the payload'}: {must}{more}")


def _name(name: str) -> str:
    """Return a sender's name in printable characters, without tokens, cut to `_MAX_NAME`."""
    return visible(_SECRET.sub("(hex digits)", name))[:_MAX_NAME]
