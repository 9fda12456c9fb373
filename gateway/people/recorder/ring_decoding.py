"""What the black box's records say, from bytes of anybody's making: each is a value of `format`, or damaged."""

import json
import math
import struct
from collections.abc import Callable
from typing import Final

from pydantic_core import from_json

from gateway.model.black_box import format as form
from gateway.model.calibration import calibration_of
from gateway.model.elkapod import measured
from gateway.model.frames import MAX_ANGLE_CDEG, Op, ServoOp
from schemas.calibration import Calibration
from schemas.telemetry import Cause


def decode(kind: int, ns: int, rest: bytes) -> form.Content | form.CarriedOut | None:
    """What a record of this type and time states; None: a type of a later version. Raises form.DamagedError."""
    reader = _READERS.get(kind)
    try:
        if kind == form.CARRIED_OUT:
            return _carried_out(ns, rest)
        return None if reader is None else reader(rest)
    except (struct.error, ValueError, IndexError, RecursionError) as error:
        raise form.DamagedRingError(str(error)) from error


def _wall_ns(rest: bytes) -> int:
    (wall_ns,) = form.WALL.unpack_from(rest)
    if not 0 <= wall_ns < form.MAX_NS:
        raise form.DamagedRingError(f"{wall_ns} ns is no time of day")
    return int(wall_ns)


def _start(rest: bytes) -> form.Start:
    facts = json.loads(rest[form.WALL.size :])
    if not isinstance(facts, dict):
        raise form.DamagedRingError("a start without facts")
    # JSON can write half a character, which no file and no terminal takes, and lists in lists without end.
    if not all(isinstance(fact, str | int | float | None) for fact in facts.values()):
        raise form.DamagedRingError("a fact is no single value")
    "".join(f"{name}{fact}" for name, fact in facts.items()).encode()
    return form.Start(_wall_ns(rest), facts)


def _command(rest: bytes) -> form.CommandRecord:
    number, sent_ms, count = form.COMMAND_HEAD.unpack_from(rest)
    flat = form.TARGET_STRUCTS[count].unpack_from(rest, form.COMMAND_HEAD.size)
    targets = tuple((flat[index], _op(flat[index + 1])) for index in range(0, len(flat), 2))
    verb, key, source = _read_texts(rest, form.COMMAND_HEAD.size + form.TARGET_STRUCTS[count].size, 3)
    return form.CommandRecord(number, verb, key, source or None, sent_ms if math.isfinite(sent_ms) else None, targets)


def _decision(rest: bytes) -> form.Decision:
    verdict, key, source = _read_texts(rest, form.DECISION_HEAD.size, 3)
    return form.Decision(form.DECISION_HEAD.unpack_from(rest)[0], verdict, key, source or None)


def _left_out(rest: bytes) -> form.LeftOut:
    (source,) = _read_texts(rest, form.DECISION_HEAD.size, 1)
    return form.LeftOut(form.DECISION_HEAD.unpack_from(rest)[0], source or None)


def _frame(rest: bytes) -> form.FrameWritten:
    transfer_ns, late_ns, number, length = form.FRAME_HEAD.unpack_from(rest)
    (cause,) = _read_texts(rest, form.FRAME_HEAD.size + length, 1)
    return form.FrameWritten(
        rest[form.FRAME_HEAD.size : form.FRAME_HEAD.size + length], cause, transfer_ns, late_ns, number
    )


def _carried_out(ns: int, rest: bytes) -> form.CarriedOut:
    after_ns, transfer_ns, length, data = form.CARRIED_OUT_HEAD.unpack_from(rest)
    if length > len(data):
        raise form.DamagedRingError(f"a frame of {length} bytes")
    command = _command(rest[form.CARRIED_OUT_HEAD.size :])
    frame = form.FrameWritten(data[:length], Cause.COMMAND, transfer_ns, 0, command.number)
    return form.CarriedOut(command, frame, ns + after_ns)


def _event(rest: bytes) -> form.EventPublished:
    kind, source, key, reason = texts = _read_texts(rest, form.EVENT_HEAD.size, 4)
    begin = form.EVENT_HEAD.size + sum(1 + len(text.encode()) for text in texts)
    detail = rest[begin:].decode("utf-8", "ignore")  # it may have been cut within a character
    return form.EventPublished(
        kind, source or None, key or None, reason or None, detail, form.EVENT_HEAD.unpack_from(rest)[0]
    )


def _calibrated(rest: bytes) -> form.Calibrated:
    report = Calibration.model_validate_json(rest)
    calibration_of(report)  # one that no gateway publishes would be drawn wrongly
    return form.Calibrated(report)


def _about(rest: bytes) -> form.About:
    facts = from_json(rest, allow_inf_nan=False)  # unlike json's, it has an end to lists within lists
    if not isinstance(facts, dict):
        raise form.DamagedRingError("versions and settings that have no names")
    return form.About(facts)


def _op(value: int) -> ServoOp:
    """Raises FrameError, a ValueError, for what is no operation."""
    if value == form.STOP_CODE:
        return ServoOp(Op.STOP)
    if value <= MAX_ANGLE_CDEG:
        return ServoOp(Op.START, value)
    return ServoOp(Op.SET, value - form.SET_CODE)


def _read_texts(rest: bytes, begin: int, count: int) -> list[str]:
    texts = []
    for _ in range(count):
        end = begin + 1 + rest[begin]
        if end > len(rest):
            raise form.DamagedRingError("a text is cut off")
        texts.append(rest[begin + 1 : end].decode())
        begin = end
    return texts


_READERS: Final[dict[int, Callable[[bytes], form.Content]]] = {
    form.START: _start,
    form.END: lambda rest: form.End(rest.decode()),
    form.COMMAND: _command,
    form.DECISION: _decision,
    form.FRAME: _frame,
    form.MODE: lambda rest: form.ModeChange(rest.decode()),
    form.EVENT: _event,
    form.CLOCK: lambda rest: form.Clock(_wall_ns(rest)),
    form.LAG: lambda rest: form.Lag(form.WALL.unpack(rest)[0]),
    form.CALIBRATION: _calibrated,
    form.ABOUT: _about,
    form.MEASURED: lambda rest: form.BodyState(measured(rest)),
    form.LEFT_OUT: _left_out,
    form.INCIDENT: lambda rest: form.IncidentBegun(_wall_ns(rest), rest[form.WALL.size :].decode()),
}
