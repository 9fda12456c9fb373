"""Reads a message into a Command, a Reset, or a Rejection, by the table of command keys: one row for each target. Pure.

A new key needs a row here. The row determines which rings are read again (`zenoh_io/rings.py`), which messages may be
Stops, the meaning of a delete and of lost messages, and how a payload is read. Only the emergency stop's key is known
elsewhere, too: it has its own rings and threads (`zenoh_io/inbox.py`, `runtime/conductor.py`).
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from pydantic import ValidationError

from gateway.model.frames import OP_START, SETS, STARTS, STOP, Frame, OneLeg, OneServo, ServoOp, servo_ids_of
from gateway.robot.core.events import Command, Reset, Targets
from gateway.robot.core.flat import into_dicts
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.rejections import (
    BAD_ENCODING,
    TOO_MANY_FIELDS,
    Rejection,
    each_name_once,
    echo_of,
    explain,
    name_given_twice,
    too_large,
)
from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES, SERVO_COMMAND, AnySender, LegCommand, LegsCommand, ResetCommand, Sender
from schemas.keys import CommandKey, Target
from schemas.robot import JOINTS, LEGS, SERVO_IDS
from schemas.words import Reason

# ---- readers: each raises pydantic's ValidationError

_OPS: Final[Mapping[str, Mapping[int, ServoOp]]] = {"start": STARTS, "set": SETS, "stop": {0: STOP}}
"""By the angle, in hundredths of a degree; a Stop has none."""
_IDS_OF_LEG: Final = {leg: servo_ids_of(leg) for leg in LEGS}
_LEG_COMMAND, _LEGS_COMMAND = into_dicts(LegCommand), into_dicts(LegsCommand)
"""Fast validators, for the setpoints of a gait."""


def _read_servo(servo_id: int, payload: bytes) -> Command:
    sent = SERVO_COMMAND.validate_json(payload)
    angle_deg = 0.0 if sent.op == "stop" else sent.angle_deg
    frame = OneServo(servo_id, _OPS[sent.op][round(angle_deg * 100)])
    own = (frame,) if frame.moves else ()
    return Command(frame.servos, frames=own, source=sent.source, sent_ms=sent.sent_ms, lease=sent.lease)


def _leg_of(leg: int, setpoints: Sequence[dict[str, Any]]) -> OneLeg:
    """Return the frame of a leg's three setpoints. A Stop has no angle."""
    return OneLeg(leg, [_OPS[each["op"]][round(each.get("angle_deg", 0) * 100)] for each in setpoints])


def _read_leg(leg: int, payload: bytes) -> Command:
    sent: dict[str, Any] = _LEG_COMMAND.validate_json(payload)
    frame = _leg_of(leg, sent["servos"])
    own = (frame,) if frame.moves else ()
    return Command(frame.servos, frames=own, source=sent["source"], sent_ms=sent["sent_ms"], lease=sent["lease"])


def _read_legs(_: int, payload: bytes) -> Command:
    sent: dict[str, Any] = _LEGS_COMMAND.validate_json(payload)
    targets: Targets = ()
    frames: tuple[Frame, ...] = ()
    moves = True
    for leg, of_leg in sorted(sent["legs"].items()):
        frame = _leg_of(int(leg), of_leg["servos"])
        targets += frame.servos
        frames += (frame,)
        if not frame.moves:
            moves = False
    own = frames if moves else ()
    return Command(targets, frames=own, source=sent["source"], sent_ms=sent["sent_ms"], lease=sent["lease"])


def _read_reset(_: int, payload: bytes) -> Reset:
    sent = ResetCommand.model_validate_json(payload or b"{}")
    return Reset(source=sent.source, sent_ms=sent.sent_ms, lease=sent.lease, estop=sent.estop)


# ---- the table


class TargetRules(NamedTuple):
    """One target. The number of its keys is the leg, the servo, or 0."""

    servos: Mapping[int, tuple[int, ...]]
    """By number: the servos that a message on the key may start, set or stop. A delete and lost messages stop them."""
    read: Callable[[int, bytes], Command | Reset] | None
    """Reads a payload; None: any payload is accepted, and means a Stop."""
    fields: Mapping[int, int] = MappingProxyType({})
    """By the number of setpoints: how many fields a payload has at most, without angles."""
    explicit_only: str | None = None
    """Set if the key must be named: how a rejected delete or wildcard continues. The sender may not have meant it."""


_OF_SENDER: Final = len(Sender.model_fields)
_ALL: Final = {0: SERVO_IDS}
_OWN: Final = {servo_id: (servo_id,) for servo_id in SERVO_IDS}

TARGETS: Final[dict[Target, TargetRules]] = {
    Target.LEGS: TargetRules(_ALL, _read_legs, {3 * legs: _OF_SENDER + 1 + 5 * legs for legs in LEGS}),
    Target.LEG: TargetRules(_IDS_OF_LEG, _read_leg, {3: _OF_SENDER + 1 + 3}),
    Target.SERVO: TargetRules(_OWN, _read_servo, {1: _OF_SENDER + 1}),
    Target.ESTOP: TargetRules(_ALL, None),
    Target.RESET: TargetRules({0: ()}, _read_reset, explicit_only=f"does not reset; put {{}} on {keys.RESET}"),
}
"""Every target. If a row is missing, `unit/robot/test_intake.py` fails, and no gateway starts."""


def servos_of(key: CommandKey) -> frozenset[int]:
    """Return the servos that a message on this key may start, set or stop."""
    return frozenset(TARGETS[key.target].servos[key.number])


def follows(key: CommandKey) -> frozenset[int]:
    """Return the servos whose older messages, on any key, are taken before a message on this key takes effect.

    A reset follows all: commands sent while the emergency stop was engaged are rejected, even if the later reset is
    received first.
    """
    return servos_of(key) or frozenset(SERVO_IDS)


def stops_of(key: CommandKey) -> Targets:
    """Return Stops for all servos that the key names."""
    return tuple((servo_id, STOP) for servo_id in TARGETS[key.target].servos[key.number])


# ---- a message

ENCODINGS: Final = frozenset({"application/json", "zenoh/bytes"})
"""JSON, and Zenoh's value for no encoding. `is_json` knows JSON's other names."""
_JSON: Final = re.compile(r"application/(json|[\w.+-]+\+json)\s*(;.*)?", re.ASCII | re.DOTALL)
MAX_COLONS: Final = 3 + 1 + len(LEGS) * (2 + 2 * len(JOINTS)) + 64
"""The colons of the largest command: source, sent_ms, lease, legs, and each leg's fields; a source may have 64 more.

A payload with more is rejected unread: pydantic lists every wrong field, and a payload full of them would block the
loop for 1.4 ms."""

_DELETE: Final = Verb.DELETE  # see `frames.OP_STOP`


def read(received: Received) -> Command | Reset | Rejection:  # noqa: PLR0911, PLR0912  (one row a case)
    """Return the request in a message, or a Rejection with the reason. Never raises."""
    key, payload = received.target, received.payload
    if key is None:
        try:
            keys.parse(echo_of(received.expression))
        except ValueError as error:
            return Rejection(Reason.INVALID, str(error))
        return Rejection(Reason.INVALID, f"{echo_of(received.expression)} names no command key")
    row = TARGETS[key.target]
    deletes = received.verb is _DELETE
    if row.explicit_only is not None:
        is_wildcard = received.expression != received.key
        if deletes or is_wildcard:
            return Rejection(Reason.INVALID, f"a {'wildcard' if is_wildcard else 'delete'} {row.explicit_only}")
    if deletes or row.read is None:
        command: Command | Reset = Command(stops_of(key) if deletes else ())
    elif received.size > MAX_PAYLOAD_BYTES:
        return too_large(received.size)
    elif received.encoding not in ENCODINGS and not is_json(received.encoding):
        return BAD_ENCODING
    elif (colons := payload.count(b":")) > MAX_COLONS:
        return TOO_MANY_FIELDS
    else:
        try:
            command = row.read(key.number, payload)
        except ValidationError as error:
            return explain(error)
        # Each field has a colon. A setpoint with no more colons than fields has no name twice and is read only once.
        if type(command) is Command:
            colons += (command.source, command.sent_ms, command.lease).count(None) - row.fields[command.left]
            colons -= len(command.moves)  # a Stop has no angle
        if colons > 0 and (rejection := name_given_twice(payload)) is not None:
            return rejection
    command.key = received.key
    command.verb = received.verb
    command.reply = received.reply
    command.received_ns = received.received_ns
    command.source_id = received.source
    if command.source is None:
        command.source = received.source
    return command


def _may_contain_stop(payload: bytes) -> bool:  # mutants accepted (Step): a shortcut: what follows finds the same
    """Return whether a payload may contain a Stop, in any spelling. It has false positives, but misses none.

    JSON's escapes in a word have a backslash. A payload that does not begin like a JSON object (binary, a byte order
    mark) or has a NUL (UTF-16) cannot be searched for a word.
    """
    if b"stop" in payload or b"\\" in payload or b"\0" in payload:
        return True
    if payload[:1] == b"{" and payload.islower():
        return False  # a usual setpoint
    return payload.lstrip()[:1] not in (b"", b"{") or b"stop" in payload.lower()


def words_of_stop(received: Received) -> bytes | None:
    """Return the payload of a message that may be a Stop, else None. A payload too large to read may be one.

    No older Start overtakes such a message, newer messages of its key do not displace it, and it stops its servos even
    if it is rejected.
    """
    if received.verb is _DELETE:
        return b""
    key, payload = received.target, received.payload
    if key is None:
        return None
    row = TARGETS[key.target]
    by_key = row.read is None or received.size > MAX_PAYLOAD_BYTES
    return payload if row.servos[key.number] and (by_key or _may_contain_stop(payload)) else None


# ---- Stops that may have been lost, or rejected for their form. A Stop too many is harmless.

LOST: Final = (
    "messages were lost on the way to the gateway: more came at once than it keeps, and a stop may be among them, "
    "so it counts as received; start again once the link is fast enough"
)
"""A flood pushes older messages out of its key's ring. So the key's servos are stopped, except those that one of the
remaining messages starts."""


def not_started(stops: Targets, by: Targets) -> Targets:
    """Return those of the Stops of lost messages that are still needed after an accepted message with these targets."""
    started = {servo_id for servo_id, op in by if op.op is OP_START}
    return tuple(stop for stop in stops if stop[0] not in started)


def stops_in(rejected: Received) -> Targets:
    """Return Stops for all servos of a rejected message's key if the message may contain a Stop."""
    key = rejected.target
    if key is None or words_of_stop(rejected) is None:
        return ()
    with suppress(ValueError, RecursionError):
        payload = json.loads(rejected.payload, object_pairs_hook=each_name_once)
        if isinstance(payload, dict) and isinstance(payload.get("source"), str):
            del payload["source"]  # a name may contain any word
        if "stop" not in json.dumps(payload, ensure_ascii=False).casefold():
            return ()
    return stops_of(key)


# ---- parts of a message


def is_json(encoding: str) -> bool:
    """Return whether an encoding is JSON: `application/json` or `application/*+json` with any parameters, or none."""
    return encoding in ENCODINGS or _JSON.fullmatch(encoding) is not None


def named_source(payload: bytes) -> str | None:
    """Return the sender in the payload of an emergency stop, or None. Any payload stops. Never raises."""
    try:
        return AnySender.model_validate_json(payload).source
    except ValidationError:
        return None
