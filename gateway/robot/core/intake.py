"""Reads a message into a Command, a Reset, or a Rejection, by the table of command keys: one row for each target. Pure.

A new key needs a row here. The row determines which rings are read again (`zenoh_io/rings.py`), which messages may be
Stops, the meaning of a delete and of lost messages (`losses`), and how a payload is read. Only the emergency stop's key
is known elsewhere, too: it has its own rings and threads (`zenoh_io/inbox.py`, `runtime/conductor.py`).
"""

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple

from pydantic import ValidationError

from gateway.model.frames import SETS, STARTS, STOP, ServoOp, servo_ids_of
from gateway.robot.core.events import Command, Reset, Targets
from gateway.robot.core.flat import into_dicts
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.rejections import (
    BAD_ENCODING,
    TOO_MANY_FIELDS,
    Rejection,
    echo_of,
    explain,
    name_given_twice,
    too_large,
)
from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES, SENDER, SERVO_COMMAND, LegCommand, LegsCommand, ResetCommand
from schemas.keys import CommandKey, Target
from schemas.robot import JOINTS, LEGS, SERVO_IDS
from schemas.telemetry import Reason

# ---- readers: each raises pydantic's ValidationError

_OPS: Final[Mapping[str, Mapping[int, ServoOp]]] = {"start": STARTS, "set": SETS, "stop": {0: STOP}}
"""By the angle, in hundredths of a degree; a Stop has none."""
_IDS_OF_LEG: Final = {leg: servo_ids_of(leg) for leg in LEGS}
_LEG_COMMAND, _LEGS_COMMAND = into_dicts(LegCommand), into_dicts(LegsCommand)
"""Fast validators, for the setpoints of a gait."""


def _read_servo(servo_id: int, payload: bytes) -> Command:
    command = SERVO_COMMAND.validate_json(payload)
    angle_deg = 0.0 if command.op == "stop" else command.angle_deg
    op = _OPS[command.op][round(angle_deg * 100)]
    return Command(((servo_id, op),), source=command.source, sent_ms=command.sent_ms, lease=command.lease)


def _read_leg(leg: int, payload: bytes) -> Command:
    command: dict[str, Any] = _LEG_COMMAND.validate_json(payload)
    return _of_legs({leg: command["servos"]}, command)


def _read_legs(_: int, payload: bytes) -> Command:
    command: dict[str, Any] = _LEGS_COMMAND.validate_json(payload)
    return _of_legs({int(leg): of_leg["servos"] for leg, of_leg in sorted(command["legs"].items())}, command)


def _read_reset(_: int, payload: bytes) -> Reset:
    command = ResetCommand.model_validate_json(payload or b"{}")
    return Reset(source=command.source, sent_ms=command.sent_ms, lease=command.lease, estop=command.estop)


def _of_legs(setpoints: Mapping[int, Iterable[dict[str, Any]]], sent: dict[str, Any]) -> Command:
    """Return the command for these legs, with angles rounded to hundredths of a degree, as in `centidegrees`."""
    by_leg: dict[int, Targets] = {}
    targets: Targets = ()
    for leg, of_leg in setpoints.items():
        ops = [_OPS[each["op"]][round(each.get("angle_deg", 0) * 100)] for each in of_leg]
        by_leg[leg] = tuple(zip(_IDS_OF_LEG[leg], ops, strict=True))
        targets += by_leg[leg]
    return Command(targets, by_leg=by_leg, source=sent["source"], sent_ms=sent["sent_ms"], lease=sent["lease"])


# ---- the table


class TargetRules(NamedTuple):  # mutants accepted (Step): no fields stand around less than a leg
    """One target. The number of its keys is the leg, the servo, or 0."""

    servos: Mapping[int, tuple[int, ...]]
    """By number: the servos that a message on the key may start, set or stop. A delete and lost messages stop them."""
    read: Callable[[int, bytes], Command | Reset] | None
    """Reads a payload; None: any payload is accepted, and means a Stop."""
    fields_around: tuple[int, int] = (0, 0)
    """The number of fields around setpoints: once, and for each leg."""
    explicit_only: str | None = None
    """Set if the key must be named: how a rejected delete or wildcard continues. The sender may not have meant it."""


_ALL: Final = {0: SERVO_IDS}
_OWN: Final = {servo_id: (servo_id,) for servo_id in SERVO_IDS}

TARGETS: Final[dict[Target, TargetRules]] = {
    Target.LEGS: TargetRules(_ALL, _read_legs, (1, 2)),
    Target.LEG: TargetRules(_IDS_OF_LEG, _read_leg, (1, 0)),
    Target.SERVO: TargetRules(_OWN, _read_servo),
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
    deletes = received.verb is _DELETE
    if row.explicit_only is not None:
        is_wildcard = received.expression != received.key
        if deletes or is_wildcard:
            return Rejection(Reason.INVALID, f"a {'wildcard' if is_wildcard else 'delete'} {row.explicit_only}")
    found = Command(stops_of(key)) if deletes else _decoded(row, key.number, received)
    if type(found) is not Rejection:
        found.key, found.verb, found.reply = received.key, received.verb, received.reply
        found.received_ns, found.source_id = received.received_ns, received.source
        found.source = found.source or received.source
    return found


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


def is_json(encoding: str) -> bool:
    """Return whether an encoding is JSON: `application/json` or `application/*+json` with any parameters, or none."""
    return encoding in ENCODINGS or _JSON.fullmatch(encoding) is not None


def _decoded(row: TargetRules, number: int, received: Received) -> Command | Reset | Rejection:
    if row.read is None:
        return Command()
    if received.size > MAX_PAYLOAD_BYTES:
        return too_large(received.size)
    if received.encoding not in ENCODINGS and not is_json(received.encoding):
        return BAD_ENCODING
    payload = received.payload
    colons = payload.count(b":")
    if colons > MAX_COLONS:
        return TOO_MANY_FIELDS
    try:
        command = row.read(number, payload)
    except ValidationError as error:
        return explain(error)
    # Each field has a colon. A setpoint with no more colons than fields has no name twice and is read only once.
    if type(command) is Command:
        once, each_leg = row.fields_around
        colons -= (command.source is not None) + (command.sent_ms is not None) + (command.lease is not None)
        colons -= once + each_leg * len(command.by_leg) + command.left + len(command.moves)  # a Stop has no angle
    return command if colons <= 0 else name_given_twice(payload) or command


def named_source(payload: bytes) -> str | None:
    """Return the sender in the payload of an emergency stop, or None. Any payload stops. Never raises."""
    try:
        return SENDER.validate_json(payload).source
    except ValidationError:
        return None
