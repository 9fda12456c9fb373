"""`decode`: explains a frame's bytes, or names their fault."""

import json
import re
from collections.abc import Iterator, Sequence
from typing import Any

from gateway.model import frames
from gateway.model.frames import FrameError, OneLeg, Op
from gateway.people.terminal import say
from gateway.words.text import echo

_FRAME_HEADERS = frozenset(
    (bytes((frames.ONE_LEG_LEN, frames.ONE_LEG_TYPE)), bytes((frames.ONE_SERVO_LEN, frames.ONE_SERVO_TYPE)))
)
"""FRAME LEN and FRAME TYPE of the two kinds of frames."""


def decode(hex_bytes: Sequence[str], *, as_json: bool = False) -> int:
    """Print what frames mean, a line or a JSON object each. Returns the exit code: 1 if one is faulty."""
    try:
        data = b"".join(map(_bytes, " ".join(hex_bytes).replace(",", " ").split()))
    except ValueError as error:
        say(json.dumps({"fault": str(error)}) if as_json else str(error))
        return 1
    for piece in _frames(data):
        try:
            say(_explained(piece, as_json=as_json))
        except FrameError as error:
            fault = {"bytes": piece.hex(), "fault": str(error)}
            say(json.dumps(fault) if as_json else f"{piece.hex(' ') or 'nothing'}: not legal: {error}")
            return 1
    return 0


def _explained(data: bytes, *, as_json: bool) -> str:
    """Return what a frame means. Raises FrameError."""
    frame = frames.decode(data)
    servos: list[dict[str, Any]] = [
        {"id": servo_id, "op": command.op.name.lower()}
        | ({} if command.op is Op.STOP else {"angle_deg": command.angle_cdeg / 100})
        for servo_id, command in frame.servos
    ]
    if as_json:
        return json.dumps({"bytes": data.hex(), "leg": frame.leg, "servos": servos})
    name = f"ONE LEG, leg {frame.leg}" if isinstance(frame, OneLeg) else "ONE SERVO"
    angles = (f" {each['angle_deg']:.2f}°" if "angle_deg" in each else "" for each in servos)
    ops = (f"servo {each['id']} {each['op']}{angle}" for each, angle in zip(servos, angles, strict=True))
    return f"{data.hex(' ')}: {name}: {', '.join(ops)}"


def _bytes(word: str) -> bytes:
    """Return the bytes of `06`, `0x06`, `0x6` or `060220020000`. Raises ValueError, also for half a byte."""
    if re.fullmatch(r"0x[0-9a-fA-F]", word):
        word = f"0{word[2:]}"
    digits = word.removeprefix("0x")
    if not re.fullmatch(r"[0-9a-fA-F]+", digits):
        raise ValueError(f"{echo(word)} is not hexadecimal")
    if len(digits) % 2:
        raise ValueError(f"{echo(word)} ends with half a byte; a byte has two digits, such as 06")
    return bytes.fromhex(digits)


def _frames(data: bytes) -> Iterator[bytes]:
    """Split off whole frames from the front. The rest is one piece."""
    while data[:2] in _FRAME_HEADERS and len(data) > data[0]:
        yield data[: data[0]]
        data = data[data[0] :]
    yield data
