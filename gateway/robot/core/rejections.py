"""Why a payload is rejected, in a sentence for its sender. Pure."""

import json
import math
import re
from typing import Any, Final, final

from pydantic import ValidationError
from pydantic_core import from_json

from gateway.robot.core.message import value
from gateway.text import BOM, decimal_comma
from schemas.calibration import MAX_TRIM_DEG
from schemas.command import MAX_NUMBER, MAX_PAYLOAD_BYTES, MAX_SENT_MS
from schemas.robot import JOINTS, SERVO_IDS
from schemas.telemetry import Reason

MAX_KEY: Final = 100
"""Characters of an unknown key that an event repeats; ours have at most 20."""
_MAX_ECHO: Final = 40
"""Characters of a sender's value or name that a rejection repeats."""
_MAX_ECHO_BITS: Final = 128
_SECRET: Final = re.compile(r"[0-9a-fA-F]{32,}")
"""Text that may be a lease's token in the wrong field."""
_PLAIN_NAME: Final = re.compile(r"[\w./-]{1,40}", re.ASCII)
_SERVO_OPS: Final = ("start", "set", "stop")


@final
@value
class Rejection:
    """The reason for rejecting a command, and a sentence for its sender."""

    reason: Reason
    detail: str


def echo_of(key: str) -> str:
    """Return an unknown key for an event: at most `MAX_KEY` characters, without secrets."""
    return without_secrets(key[: 2 * MAX_KEY])[:MAX_KEY]


def too_large(size: int, most: int = MAX_PAYLOAD_BYTES) -> Rejection:
    """Return the rejection of a payload of `size` bytes, more than the `most` that are read."""
    return Rejection(Reason.TOO_LARGE, f"the payload has {size} bytes; at most {most} are read")


def bad_encoding(encoding: str) -> Rejection:
    """Return the rejection of a payload that is not sent as JSON."""
    detail = f"the encoding is {_name(encoding)}; it must be application/json, or left out"
    return Rejection(Reason.BAD_ENCODING, detail)


def too_many_fields(payload: bytes) -> Rejection:
    """Return the rejection of a payload that has too many colons to be a command."""
    try:
        from_json(payload)
    except ValueError as error:
        return _malformed(payload, str(error))
    return Rejection(Reason.INVALID, "the payload has more fields than any command of its key has")


class _GivenTwiceError(ValueError):
    """An object of the payload has a name twice; the text is the name."""


def name_given_twice(payload: bytes) -> str | None:
    """Return the first name that an object of this valid payload has twice, or None.

    pydantic silently keeps the last value, but the sender may have meant the other one.
    """
    if payload:
        try:
            json.loads(payload, object_pairs_hook=each_name_once)
        except _GivenTwiceError as error:
            return str(error)
    return None


def each_name_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Make a JSON object. Raises ValueError if a name is given twice."""
    found: dict[str, object] = {}
    for name, each in pairs:
        if name in found:
            raise _GivenTwiceError(name)
        found[name] = each
    return found


# ---- an invalid payload


def given_twice(name: str) -> Rejection:
    """Return the rejection of a payload in which an object has this name twice."""
    return Rejection(Reason.INVALID, f"{_name(name)} is given twice in one object; give it once")


def explain(error: ValidationError) -> Rejection:  # mutants accepted (FalseWithTrue, LeaveOut): only time is lost
    """Return the rejection of an invalid payload, in a sentence that names the field and what it must be."""
    faults = error.errors(include_url=False)
    first = faults[0]
    if first["type"] == "json_invalid":
        return _malformed(first["input"], first["ctx"]["error"])
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return Rejection(Reason.INVALID, f"{_sentence(dict(first))}{more}")


def _malformed(payload: bytes | str, why: str) -> Rejection:
    """Return the rejection of a payload that is not JSON, with the cause if it is a common one."""
    text = payload if isinstance(payload, str) else payload.decode(errors="replace")
    cause = "it begins with a byte order mark; send it without" if text.startswith(BOM) else decimal_comma(text)
    return Rejection(Reason.MALFORMED, f"the payload is not JSON: {cause or why}")


def _sentence(fault: dict[str, Any]) -> str:
    loc = fault["loc"]
    where = _path(loc)
    field = loc[-1] if loc else None
    if where == "lease" and fault["type"] != "missing":
        return "lease must be 32 hex digits, a to f in lower case"  # the value may be most of a secret
    match fault["type"]:
        case "missing":
            return f"{where} is missing" + (f"; a leg has {len(JOINTS)} servos" if isinstance(field, int) else "")
        case "extra_forbidden":
            return f"{where} is not known here" + ("; stop takes no angle" if loc[-2:] == ("stop", "angle_deg") else "")
        case "string_too_short" | "string_too_long":
            return f"{where} must have 1 to 64 characters"
        case "union_tag_invalid":
            return f'{_join(where, "op")} is {_echo(fault["input"]["op"])}; it must be "start", "set" or "stop"'
        case "union_tag_not_found":
            return f'{_join(where, "op")} is missing; it must be "start", "set" or "stop"'
        case "literal_error" if field == "[key]":
            may = '"1" to "6"' if loc[0] == "legs" else '"11" to "63": the leg (1 to 6), then the joint (1 to 3)'
            return f"{loc[0]} has {_echo(fault['input'])}; it may have {may}"
        case "too_long":
            return f"{where} has {fault['ctx']['actual_length']} entries; a leg has {len(JOINTS)} servos"
        case "too_short":
            return "legs is empty; name at least one leg"
        case kind:
            must = _MUST.get(kind) or _RANGES.get(field) or "what the schema requires"
            return f"{where or 'the payload'} is {_echo(fault['input'])}; it must be {must}"


_MUST: Final = {
    "finite_number": "a finite number",
    "float_type": "a number",
    "string_type": "a string",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "tuple_type": "an array",
    "model_type": "an object",
    "dict_type": "an object",
    "model_attributes_type": "an object",
    "bool_type": "true or false",
    "literal_error": "true, or left out",  # accept_default
}
_RANGES: Final[dict[object, str]] = {
    "angle_deg": "between 0 and 180",
    "sent_ms": f"between 0 and {MAX_SENT_MS}",
    "estop": f"between 0 and {MAX_NUMBER}",
    "revision": "0 or more",
    "trim_deg": f"between {-MAX_TRIM_DEG:g} and {MAX_TRIM_DEG:g}",
    **dict.fromkeys(("min_deg", "max_deg", *map(str, SERVO_IDS)), "between 0 and 180"),  # a landing angle is a servo's
}


def _path(loc: tuple[int | str, ...]) -> str:
    """Return the place in the JSON, such as `servos[2].angle_deg`, without the union members that pydantic adds.

    Only the last part may be a name of the sender's.
    """
    path = ""
    for index, part in enumerate(loc):
        if isinstance(part, int):
            path += f"[{part}]"
        elif index < len(loc) - 1 and part in _SERVO_OPS and (index == 0 or isinstance(loc[index - 1], int)):
            continue
        else:
            path = _join(path, _name(part))
    return path


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def without_secrets(text: str) -> str:
    """Return a sender's text without parts that may be a lease's token."""
    return _SECRET.sub("(hex digits)", text)


def _name(name: str) -> str:
    """Return a short, plain name unchanged, and any other quoted."""
    return name if _PLAIN_NAME.fullmatch(name) and not _SECRET.search(name) else _echo(name)


def _echo(value: object) -> str:
    """Return a value as JSON in ASCII, on one line, without tokens, cut to `_MAX_ECHO` characters."""
    if isinstance(value, int) and value.bit_length() > _MAX_ECHO_BITS:
        # Thousands of digits take long to write out.
        return f"a whole number of about {round(value.bit_length() * math.log10(2))} digits"
    text = without_secrets(json.dumps(value))
    return text if len(text) <= _MAX_ECHO else text[:_MAX_ECHO] + "…"
