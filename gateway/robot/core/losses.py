"""Determines the servos to stop for a Stop that may have been lost, or rejected for its form. Pure.

A flood pushes older messages out of its key's ring, and a Stop may be among them. So the key's servos are stopped,
except those that one of the remaining messages starts.

A message that is rejected for its form, and may contain a Stop, stops the servos that its payload names, or all servos
of its key if the payload cannot be read. A Stop too many is harmless.
"""

import json
from contextlib import suppress
from typing import Final

from gateway.model.frames import OP_START, STOP, servo_ids_of
from gateway.robot.core.events import Targets
from gateway.robot.core.intake import TARGETS, words_of_stop
from gateway.robot.core.message import Received
from gateway.robot.core.rejections import each_name_once
from schemas.robot import JOINTS, LEGS, SERVO_IDS

DETAIL: Final = (
    "messages were lost on the way to the gateway: more came at once than it keeps, and a stop may be among them, "
    "so it counts as received; start again once the link is fast enough"
)


def not_started(stops: Targets, by: Targets) -> Targets:
    """Return those of the Stops of lost messages that are still needed after an accepted message with these targets."""
    started = {servo_id for servo_id, op in by if op.op is OP_START}
    return tuple(stop for stop in stops if stop[0] not in started)


def stops_in(rejected: Received) -> Targets:
    """Return Stops for the servos that a rejected message may stop."""
    key = rejected.target
    if key is None or words_of_stop(rejected) is None:
        return ()
    servo_ids = TARGETS[key.target].servos[key.number]
    with suppress(ValueError, RecursionError):  # all servos of the key
        payload = json.loads(rejected.payload, object_pairs_hook=each_name_once)
        if isinstance(payload, dict) and isinstance(payload.get("source"), str):
            del payload["source"]  # a name may contain any word
        servo_ids = _stopped_by(payload, servo_ids)
    return tuple((servo_id, STOP) for servo_id in servo_ids)


_FIELDS: Final = {len(SERVO_IDS): "legs", len(JOINTS): "servos"}
_NUMBERS: Final = {str(leg): servo_ids_of(leg) for leg in LEGS}


# mutants accepted (Step): one servo stands for what names none
def _stopped_by(part: object, servo_ids: tuple[int, ...]) -> tuple[int, ...]:
    """Return those of these servos that a part of a payload may stop: all, unless it has a place for each of them."""
    if "stop" not in json.dumps(part, ensure_ascii=False).casefold():
        return ()
    field = _FIELDS.get(len(servo_ids))
    inner = part.get(field) if isinstance(part, dict) else None
    if field == "legs" and isinstance(inner, dict) and inner.keys() <= _NUMBERS.keys():
        parts: list[tuple[tuple[int, ...], object]] = [(_NUMBERS[leg], each) for leg, each in inner.items()]
    elif field == "servos" and isinstance(inner, list) and len(inner) == len(JOINTS):
        parts = [((servo_id,), each) for servo_id, each in zip(servo_ids, inner, strict=True)]
    else:
        return servo_ids
    if isinstance(part, dict) and _stopped_by({**part, field: None}, servo_ids[:1]):
        return servo_ids
    return tuple(servo_id for its_ids, each in parts for servo_id in _stopped_by(each, its_ids))
