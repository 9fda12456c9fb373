"""What the keys that take `get` only have in common: who may be read at all, before anybody owns the robot's state."""

from collections.abc import Callable
from typing import Final

import zenoh
from pydantic import ValidationError

from gateway.robot.core.intake import ENCODINGS, Rejection, too_large
from gateway.robot.core.message import Reply
from gateway.robot.edge.receiver import Deal
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.telemetry import Reason

Reader = Callable[[zenoh.Query, int, Reply], Deal]
"""Reads one question, which came at this time (ns), on a thread that owns nothing."""

BY_WILDCARD: Final = Rejection(Reason.INVALID, "this key is not asked by wildcard: name it")
BAD_ENCODING: Final = Rejection(Reason.BAD_ENCODING, "the encoding must be application/json, or left out")


def why_unread(error: ValidationError, does: str) -> tuple[Reason, str]:
    """Why a request cannot be read, which may `do` these. Nothing of what was sent is repeated: it may be a secret."""
    first = error.errors(include_url=False, include_input=False)[0]
    if first["type"] == "json_invalid":
        return Reason.MALFORMED, "the payload is not JSON"
    # The names in it are ours, but for one that is not known; the first is the verb's, which pydantic adds.
    known = [str(part) for part in first["loc"][1:]]
    if first["type"].startswith("union_tag") or not known:
        return Reason.INVALID, f"do must be {does}"
    if first["type"] == "extra_forbidden":
        return Reason.INVALID, "the payload has a field that is not known here"
    return Reason.INVALID, f"{'.'.join(known)} is missing, or not what docs/interface.md says"


def payload_of(query: zenoh.Query, most: int = MAX_PAYLOAD_BYTES) -> bytes | Rejection:
    """The payload, of `most` bytes at most, or why it is not read."""
    payload = query.payload
    if "*" in str(query.key_expr):  # whoever lists what there is wants to see, and asks for nothing
        return BY_WILDCARD
    if payload is not None and len(payload) > most:
        return too_large(len(payload), most)
    if query.encoding is not None and str(query.encoding) not in ENCODINGS:
        return BAD_ENCODING
    return b"" if payload is None else payload.to_bytes()
