"""From what Zenoh delivered to what somebody wants, or why not. Nothing else here knows the commands' JSON."""

import json
from dataclasses import dataclass
from typing import Any, Final

from pydantic import ValidationError

from gateway.protocol.frames import STOP, Op, ServoOp, centidegrees, servo_ids_of
from schemas.command import (
    MAX_PAYLOAD_BYTES,
    SERVO_COMMAND,
    LegCommand,
    LegsCommand,
    Move,
    ResetCommand,
    Stop,
)
from schemas.keys import CommandKey, Target
from schemas.robot import JOINTS, LEGS, SERVO_IDS
from schemas.telemetry import Reason

ENCODINGS: Final = frozenset({"application/json", "zenoh/bytes"})
"""JSON, and what Zenoh says when the publisher said nothing."""

Targets = tuple[tuple[int, ServoOp], ...]
_OPS: Final = {"start": Op.START, "set": Op.SET}


@dataclass(frozen=True, slots=True)
class Intent:
    """What a good command asks for: an operation for each servo that it names (none for a reset)."""

    targets: Targets = ()
    source: str | None = None
    sent_ms: float | None = None


@dataclass(frozen=True, slots=True)
class Rejection:
    """Why a command is refused, and a sentence that helps whoever sent it."""

    reason: Reason
    detail: str


def decode(key: CommandKey, payload: bytes, encoding: str) -> Intent | Rejection:
    """Read the payload that came on `key`. Any bytes will do: what is wrong is returned, never raised."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        return too_large(len(payload))
    if encoding not in ENCODINGS:
        return Rejection(
            Reason.BAD_ENCODING, f"the encoding is {encoding[:64]}; it must be application/json, or left out"
        )
    try:
        return _READERS[key.target](key.number, payload)
    except ValidationError as error:
        return _explain(error)


def stop_all_of(key: CommandKey) -> Intent | Rejection:
    """What a `delete` on `key` asks for: Stops for the servos that the key names."""
    match key.target:
        case Target.SERVO:
            return Intent(((key.number, STOP),))
        case Target.LEG:
            return Intent(tuple((servo_id, STOP) for servo_id in servo_ids_of(key.number)))
        case Target.LEGS:
            return Intent(tuple((servo_id, STOP) for servo_id in SERVO_IDS))
        case _:
            # Leaving the emergency stop is a deliberate act; deleting a key (perhaps by a wildcard) is not.
            return Rejection(Reason.INVALID, "a delete does not reset; put {} on this key")


def too_large(size: int) -> Rejection:
    """The answer to a payload that is not even looked at."""
    return Rejection(Reason.TOO_LARGE, f"the payload has {size} bytes; at most {MAX_PAYLOAD_BYTES} are read")


def _read_servo(servo_id: int, payload: bytes) -> Intent:
    command = SERVO_COMMAND.validate_json(payload)
    return Intent(((servo_id, _op(command)),), command.source, command.sent_ms)


def _read_leg(leg: int, payload: bytes) -> Intent:
    command = LegCommand.model_validate_json(payload)
    targets = tuple(zip(servo_ids_of(leg), map(_op, command.servos), strict=True))
    return Intent(targets, command.source, command.sent_ms)


def _read_legs(_: int, payload: bytes) -> Intent:
    command = LegsCommand.model_validate_json(payload)
    targets = tuple(
        (servo_id, _op(setpoint))
        for leg in LEGS
        if str(leg) in command.legs
        for servo_id, setpoint in zip(servo_ids_of(leg), command.legs[str(leg)].servos, strict=True)  # type: ignore[index]
    )
    return Intent(targets, command.source, command.sent_ms)


def _read_reset(_: int, payload: bytes) -> Intent:
    if payload:
        ResetCommand.model_validate_json(payload)
    return Intent()


def _read_estop(_: int, _payload: bytes) -> Intent:
    return Intent()


_READERS: Final = {
    Target.SERVO: _read_servo,
    Target.LEG: _read_leg,
    Target.LEGS: _read_legs,
    Target.RESET: _read_reset,
    Target.ESTOP: _read_estop,
}


def _op(setpoint: Move | Stop) -> ServoOp:
    return ServoOp(_OPS[setpoint.op], centidegrees(setpoint.angle_deg)) if isinstance(setpoint, Move) else STOP


# ---- refusals in words

_MAX_ECHO: Final = 40
"""Characters of the sender's own value that an answer repeats."""


def _explain(error: ValidationError) -> Rejection:
    faults = error.errors(include_url=False)
    first = faults[0]
    if first["type"] == "json_invalid":
        return Rejection(Reason.MALFORMED, f"the payload is not JSON: {first['ctx']['error']}")
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return Rejection(Reason.INVALID, f"{_sentence(dict(first))}{more}")


def _sentence(fault: dict[str, Any]) -> str:
    """One sentence that names the field and what it must be."""
    where = _path(fault["loc"])
    value = _echo(fault["input"])
    context = fault.get("ctx", {})
    match fault["type"]:
        case "missing":
            return f"{where} is missing" + (f"; a leg has {len(JOINTS)} servos" if where.endswith("]") else "")
        case "extra_forbidden":
            return f"{where} is not known here" + ("; stop takes no angle" if where.endswith("angle_deg") else "")
        case "less_than_equal" | "greater_than_equal":
            limits = "between 0 and 180" if where.endswith("angle_deg") else "0 or more"
            return f"{where} is {value}; it must be {limits}"
        case "finite_number":
            return f"{where} is {value}; it must be a finite number"
        case "float_type":
            return f"{where} is {value}; it must be a number"
        case "string_type":
            return f"{where} is {value}; it must be a string"
        case "string_too_short" | "string_too_long":
            return f"{where} must have 1 to 64 characters"
        case "union_tag_invalid":
            return f'{_join(where, "op")} is {_echo(context["tag"])}; it must be "start", "set" or "stop"'
        case "union_tag_not_found":
            return f'{_join(where, "op")} is missing; it must be "start", "set" or "stop"'
        case "literal_error" if fault["loc"][-1] == "[key]":
            return f'legs has {value}; it may have "1" to "6"'
        case "too_long" if where.endswith("servos"):
            return f"{where} has {context['actual_length']} entries; a leg has {len(JOINTS)} servos"
        case "too_short" if where == "legs":
            return "legs is empty; name at least one leg"
        case "model_type" | "dict_type" | "model_attributes_type":
            return f"{where or 'the payload'} is {value}; it must be an object"
        case "tuple_type":
            return f"{where} is {value}; it must be an array"
        case _:
            return f"{where or 'the payload'}: {fault['msg']}"


def _path(loc: tuple[int | str, ...]) -> str:
    """`servos[2].angle_deg`: the place in the JSON; the names of union members, which pydantic adds, are left out."""
    path = ""
    for index, part in enumerate(loc):
        if isinstance(part, int):
            path += f"[{part}]"
        elif part == "[key]" or (part in ("start", "set", "stop") and (index == 0 or isinstance(loc[index - 1], int))):
            continue
        else:
            path = _join(path, part)
    return path


def _join(path: str, name: str) -> str:
    return f"{path}.{name}" if path else name


def _echo(value: object) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= _MAX_ECHO else text[:_MAX_ECHO] + "…"
