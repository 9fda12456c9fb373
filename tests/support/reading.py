"""What a message asks for, as a value that tests compare."""

from typing import NamedTuple

from gateway.robot.core.events import Command, Reset, Targets
from gateway.robot.core.intake import Rejection, read
from gateway.robot.core.message import Received, Verb
from schemas.keys import CommandKey


class Intent(NamedTuple):
    """A command or a reset, without how it came."""

    targets: Targets = ()
    source: str | None = None
    sent_ms: float | None = None
    estop: int | None = None
    lease: str | None = None


def meant(answer: Command | Reset | Rejection) -> Intent | Rejection:
    """The intent of what was read."""
    if isinstance(answer, Rejection):
        return answer
    estop = answer.estop if isinstance(answer, Reset) else None
    return Intent(answer.targets, answer.source, answer.sent_ms, estop, answer.lease)


def decode(key: CommandKey, payload: bytes, encoding: str) -> Intent | Rejection:
    """What a `put` of this payload asks for."""
    return meant(read(Received("", "", key, Verb.PUT, payload, len(payload), encoding, None, 0)))
