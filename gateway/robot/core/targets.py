"""The table of command keys: one row for each target. Pure.

A new key needs a row here. The row determines which rings are read again (`zenoh_io/rings.py`), which messages may be
Stops, the meaning of a delete and of lost messages (`intake`, `losses`), and how a payload is read. Only the emergency
stop's key is known elsewhere, too: it has its own rings and threads (`zenoh_io/inbox.py`, `runtime/conductor.py`).
"""

from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple

from gateway.model.frames import SETS, STARTS, STOP, servo_ids_of
from gateway.robot.core.events import Command, Reset, Targets
from gateway.robot.core.flat import into_dicts
from schemas import keys
from schemas.command import SERVO_COMMAND, LegCommand, LegsCommand, ResetCommand
from schemas.keys import CommandKey, Target
from schemas.robot import JOINTS, LEGS, SERVO_IDS

# ---- readers: each raises pydantic's ValidationError

_MOVES: Final = {"start": STARTS, "set": SETS}
_IDS_OF_LEG: Final = {leg: servo_ids_of(leg) for leg in LEGS}
_LEG_COMMAND, _LEGS_COMMAND = into_dicts(LegCommand), into_dicts(LegsCommand)
"""Fast validators, for the setpoints of a gait."""


def _read_servo(servo_id: int, payload: bytes) -> Command:
    command = SERVO_COMMAND.validate_json(payload)
    op = STOP if command.op == "stop" else _MOVES[command.op][round(command.angle_deg * 100)]
    return Command(((servo_id, op),), source=command.source, sent_ms=command.sent_ms, lease=command.lease)


def _read_leg(leg: int, payload: bytes) -> Command:
    command: dict[str, Any] = _LEG_COMMAND.validate_json(payload)
    targets = _targets(((leg, command),))
    return Command(targets, source=command["source"], sent_ms=command["sent_ms"], lease=command["lease"])


def _read_legs(_: int, payload: bytes) -> Command:
    command: dict[str, Any] = _LEGS_COMMAND.validate_json(payload)
    targets = _targets(sorted(command["legs"].items()))
    return Command(targets, source=command["source"], sent_ms=command["sent_ms"], lease=command["lease"])


def _read_reset(_: int, payload: bytes) -> Reset:
    command = ResetCommand.model_validate_json(payload or b"{}")
    return Reset(source=command.source, sent_ms=command.sent_ms, lease=command.lease, estop=command.estop)


def _targets(legs: Iterable[tuple[int | str, dict[str, Any]]]) -> Targets:
    """Return the operation of each servo, with angles rounded to hundredths of a degree, as in `centidegrees`."""
    targets = []
    for leg, command in legs:
        for servo_id, setpoint in zip(_IDS_OF_LEG[int(leg)], command["servos"], strict=True):
            name = setpoint["op"]
            op = STOP if name == "stop" else _MOVES[name][round(setpoint["angle_deg"] * 100)]
            targets.append((servo_id, op))
    return tuple(targets)


# ---- the table


def _all(_number: int) -> tuple[int, ...]:
    return SERVO_IDS


def _none(_number: int) -> tuple[int, ...]:
    return ()


def _own(servo_id: int) -> tuple[int, ...]:
    return (servo_id,)


def may_contain_stop(payload: bytes) -> bool:  # mutants accepted (Step): a shortcut: what follows finds the same
    """Return whether a payload may contain a Stop, in any spelling. It has false positives, but misses none.

    JSON's escapes in a word have a backslash. A payload that does not begin like a JSON object (binary, a byte order
    mark) or has a NUL (UTF-16) cannot be searched for a word.
    """
    if b"stop" in payload or b"\\" in payload or b"\0" in payload:
        return True
    if payload[:1] == b"{" and payload.islower():
        return False  # a usual setpoint
    return payload.lstrip()[:1] not in (b"", b"{") or b"stop" in payload.lower()


class TargetRules(NamedTuple):  # mutants accepted (Step): no fields stand around less than a leg
    """One target. A key's `number` is the leg, the servo, or 0."""

    servos: Callable[[int], tuple[int, ...]]
    """The servos that a message on the key may start, set or stop. A delete stops them, and so do lost messages."""
    follows: Callable[[int], tuple[int, ...]]
    """The servos whose older messages, on any key, are taken before a message on this key takes effect."""
    read: Callable[[int, bytes], Command | Reset] | None
    """Reads a payload; None: any payload is accepted."""
    may_stop: bool | None
    """Whether a message may be a Stop; None: its payload decides (`may_contain_stop`).

    No older Start overtakes such a message, newer messages of its key do not displace it, and it stops its servos even
    if it is rejected.
    """
    most_fields: int
    """The fields of a full payload. Each takes a colon, and `source` may have 64 more.

    A payload with more colons is rejected unread: pydantic lists every wrong field, and a payload full of them would
    block the loop for 1.4 ms.
    """
    fields_around: tuple[int, int] = (0, 0)
    """The number of fields around setpoints: once, and for each leg."""
    explicit_only: str | None = None
    """Set if the key must be named: how a rejected delete or wildcard continues. The sender may not have meant it."""


_SENDER, _SETPOINT, _LEG = 3, 2, 2 * len(JOINTS)
"""Fields: source, sent_ms and lease; op and angle_deg of a servo; the same of a leg."""

TARGETS: Final[dict[Target, TargetRules]] = {
    Target.LEGS: TargetRules(_all, _all, _read_legs, None, _SENDER + 1 + len(LEGS) * (2 + _LEG), (1, 2)),
    Target.LEG: TargetRules(servo_ids_of, servo_ids_of, _read_leg, None, _SENDER + 1 + _LEG, (1, 0)),
    Target.SERVO: TargetRules(_own, _own, _read_servo, None, _SENDER + _SETPOINT),
    Target.ESTOP: TargetRules(_all, _all, None, True, 0),  # mutants accepted (Step): nothing of its payload is read
    # Commands sent while the emergency stop was engaged are rejected, even if a later reset is received first.
    Target.RESET: TargetRules(
        _none, _all, _read_reset, False, _SENDER + 1, explicit_only=f"does not reset; put {{}} on {keys.RESET}"
    ),
}
"""Every target. If a row is missing, `unit/robot/test_intake.py` fails, and no gateway starts."""


def servos_of(key: CommandKey) -> frozenset[int]:
    """Return the servos that a message on this key may start, set or stop."""
    return frozenset(TARGETS[key.target].servos(key.number))


def follows(key: CommandKey) -> frozenset[int]:
    """Return the servos whose older messages are taken before a message on this key takes effect."""
    return frozenset(TARGETS[key.target].follows(key.number))


def stops_of(key: CommandKey) -> Targets:
    """Return Stops for all servos that the key names."""
    return tuple((servo_id, STOP) for servo_id in TARGETS[key.target].servos(key.number))
