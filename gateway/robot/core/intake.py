"""Reads a message into a Command, a Reset, or a Rejection. Pure. `targets` defines each key's meaning."""

import json
import math
import re
from typing import Any, Final, final

from pydantic import ValidationError
from pydantic_core import from_json

from gateway.robot.core.events import Command, Reset
from gateway.robot.core.message import Received, Verb, value
from gateway.robot.core.targets import TARGETS, TargetRules, may_contain_stop, stops_of
from gateway.text import BOM, decimal_comma
from schemas import keys
from schemas.calibration import MAX_TRIM_DEG
from schemas.command import MAX_NUMBER, MAX_PAYLOAD_BYTES, MAX_SENT_MS, SENDER
from schemas.keys import CommandKey
from schemas.robot import JOINTS, SERVO_IDS
from schemas.telemetry import Reason

ENCODINGS: Final = frozenset({"application/json", "zenoh/bytes"})
"""JSON, and Zenoh's value for no encoding. `is_json` knows JSON's other names."""
_JSON: Final = re.compile(r"application/(json|[\w.+-]+\+json)\s*(;.*)?", re.ASCII | re.DOTALL)
MAX_COLONS_OF_SOURCE: Final = 64
MAX_KEY: Final = 100
"""Characters of an unknown key that an event repeats; ours have at most 20."""

_DELETE: Final = Verb.DELETE  # see `frames.OP_STOP`
_SERVO_OPS: Final = ("start", "set", "stop")


@final
@value
class Rejection:
    """The reason for rejecting a command, and a sentence for its sender."""

    reason: Reason
    detail: str


def read(received: Received) -> Command | Reset | Rejection:
    """Return the request in a message, or a Rejection with the reason. Never raises."""
    key = received.target
    if key is None:
        try:
            keys.parse(echo_of(received.expression))
        except ValueError as error:
            return Rejection(Reason.INVALID, str(error))
        return Rejection(Reason.INVALID, f"{echo_of(received.expression)} names no command key")
    row = TARGETS[key.target]
    if row.explicit_only is not None and received.expression != received.key:
        return Rejection(Reason.INVALID, f"a wildcard {row.explicit_only}")
    found = deleted(key) if received.verb is _DELETE else _decoded(row, key.number, received)
    if type(found) is not Rejection:
        found.key, found.verb, found.reply = received.key, received.verb, received.reply
        found.received_ns, found.source = received.received_ns, found.source or received.source
    return found


def deleted(key: CommandKey) -> Command | Rejection:
    """Return Stops for the servos of a deleted key, or a Rejection if the key takes no delete."""
    explicit_only = TARGETS[key.target].explicit_only
    return Command(stops_of(key)) if explicit_only is None else Rejection(Reason.INVALID, f"a delete {explicit_only}")


def words_of_stop(received: Received) -> bytes | None:
    """Return the payload of a message that may be a Stop, else None. A payload too large to read may be one."""
    if received.verb is _DELETE:
        return b""
    key = received.target
    may_stop = False if key is None else TARGETS[key.target].may_stop
    if may_stop is None:
        may_stop = received.size > MAX_PAYLOAD_BYTES or may_contain_stop(received.payload)
    return received.payload if may_stop else None


def is_json(encoding: str) -> bool:
    """Return whether an encoding is JSON: `application/json` or `application/*+json` with any parameters, or none."""
    return encoding in ENCODINGS or _JSON.fullmatch(encoding) is not None


def _decoded(row: TargetRules, number: int, received: Received) -> Command | Reset | Rejection:
    if row.read is None:
        return Command()
    if received.size > MAX_PAYLOAD_BYTES:
        return too_large(received.size)
    if received.encoding not in ENCODINGS and not is_json(received.encoding):
        name = _name(received.encoding)
        return Rejection(Reason.BAD_ENCODING, f"the encoding is {name}; it must be application/json, or left out")
    payload = received.payload
    colons = payload.count(b":")
    if colons > row.most_fields + MAX_COLONS_OF_SOURCE:
        return too_many_fields(payload)
    try:
        command = row.read(number, payload)
    except ValidationError as error:
        return explain(error)
    # Each field has a colon. A payload with no more colons than fields has no name twice and is read only once.
    twice = name_given_twice(payload) if colons > _fields(row, command) else None
    return command if twice is None else given_twice(twice)


def named_source(payload: bytes) -> str | None:
    """Return the sender in the payload of an emergency stop, or None. Any payload stops. Never raises."""
    try:
        return SENDER.validate_json(payload).source
    except ValidationError:
        return None


def echo_of(key: str) -> str:
    """Return an unknown key for an event: at most `MAX_KEY` characters, without secrets."""
    return without_secrets(key[: 2 * MAX_KEY])[:MAX_KEY]


def too_large(size: int, most: int = MAX_PAYLOAD_BYTES) -> Rejection:
    """Return the rejection of a payload of `size` bytes, more than the `most` that are read."""
    return Rejection(Reason.TOO_LARGE, f"the payload has {size} bytes; at most {most} are read")


def too_many_fields(payload: bytes) -> Rejection:
    """Return the rejection of a payload that has too many colons to be a command."""
    try:
        from_json(payload)
    except ValueError as error:
        return _malformed(payload, str(error))
    return Rejection(Reason.INVALID, "the payload has more fields than any command of its key has")


def _fields(row: TargetRules, command: Command | Reset) -> int:
    """Return the least number of fields of a payload with this content."""
    fields = (command.source is not None) + (command.sent_ms is not None) + (command.lease is not None)
    once, each_leg = row.fields_around
    if type(command) is Reset:
        fields += command.estop is not None
    else:
        fields += command.left + len(command.moves) + each_leg * len(command.by_leg)  # a Stop has no angle
    return fields + once


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


# ---- rejections in words

_MAX_ECHO: Final = 40
"""Characters of a sender's value or name that a rejection repeats."""
_MAX_ECHO_BITS: Final = 128
_SECRET: Final = re.compile(r"[0-9a-fA-F]{32,}")
"""Text that may be a lease's token in the wrong field."""
_PLAIN_NAME: Final = re.compile(r"[\w./-]{1,40}", re.ASCII)


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
