"""What a received message asks for."""

from typing import Final

from gateway.robot.core.intake import Intent, Rejection, decode, stop_all_of, too_large, without_secrets
from gateway.robot.core.message import Received, Verb
from schemas import keys
from schemas.command import MAX_PAYLOAD_BYTES
from schemas.telemetry import Reason

_DELETE: Final = Verb.DELETE
MAX_KEY: Final = 100
"""Characters of a key of the sender's own making that an event repeats; ours have at most 20."""


def echo_of(key: str) -> str:
    """A key of the sender's own making, as an event repeats it."""
    return without_secrets(key[: 2 * MAX_KEY])[:MAX_KEY]


def intent_of(received: Received) -> Intent | Rejection:
    """What a message other than the emergency stop asks for."""
    if received.target is None:
        try:
            keys.parse(without_secrets(received.expression[: 2 * MAX_KEY]))
        except ValueError as error:
            return Rejection(Reason.INVALID, str(error))
        return Rejection(Reason.INVALID, f"{echo_of(received.expression)} names no command key")
    if received.key == keys.RESET and received.expression != keys.RESET:
        # A wildcard may name the reset among others; leaving the emergency stop must be meant.
        return Rejection(Reason.INVALID, f"a reset is not taken from a wildcard; put it on {keys.RESET}")
    if received.verb is _DELETE:
        return stop_all_of(received.target)
    if received.size > MAX_PAYLOAD_BYTES:
        return too_large(received.size)
    return decode(received.target, received.payload, received.encoding)
