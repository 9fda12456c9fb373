"""Determines the servos to stop for a Stop that may have been lost, or rejected for its form. Pure.

A flood pushes older messages out of its key's ring, and a Stop may be among them. So the key's servos are stopped,
except those that one of the remaining messages starts.

A message that is rejected for its form, and may contain a Stop, stops all servos of its key. A Stop too many is
harmless.
"""

import json
from contextlib import suppress
from typing import Final

from gateway.model.frames import OP_START
from gateway.robot.core.events import Targets
from gateway.robot.core.intake import stops_of, words_of_stop
from gateway.robot.core.message import Received
from gateway.robot.core.rejections import each_name_once

DETAIL: Final = (
    "messages were lost on the way to the gateway: more came at once than it keeps, and a stop may be among them, "
    "so it counts as received; start again once the link is fast enough"
)


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
