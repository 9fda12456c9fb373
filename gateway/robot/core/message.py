"""What the middle and the edges share: a message as it came in, how it is answered, and where reports go.

No Zenoh here, so that whatever carries messages can be exchanged.
"""

from collections import deque
from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import Protocol

from pydantic import BaseModel

from gateway.robot.core.value import value
from schemas.keys import CommandKey

Reply = Callable[[bytes], None]
"""Sends the answer to one query. Never waits."""


class Verb(StrEnum):
    """How a message came."""

    PUT = "put"
    DELETE = "delete"
    GET = "get"
    LOST = "lost"
    """It stands for puts that were lost before those that follow, at least `size` of them: a Stop may be among them."""


@value
class Received:
    """One message as it came. `size` is the payload's; a payload that is too large is not copied out of Zenoh.

    `key` is the command key that it is for, `expression` what the sender wrote (a wildcard, or an unknown key).
    """

    key: str
    expression: str
    target: CommandKey | None
    verb: Verb
    payload: bytes
    size: int
    encoding: str
    source: str | None
    received_ns: int
    reply: Reply | None = None


class Messages(Protocol):
    """What the conductor needs of the inbox."""

    instant_open: bool
    """Whether what is taken next is of the same instant as what was taken last."""

    estops: deque[Received]
    """Emergency stops that are not carried out yet. The state's owner empties it before each message."""

    def take(self) -> Iterable[Received]:
        """What else has come, in the order in which it applies."""


class NoMessages:
    """Before the inbox is connected."""

    instant_open = False

    def __init__(self) -> None:
        self.estops = deque[Received]()

    def take(self) -> Iterable[Received]:
        """Nothing."""
        return ()


class Outbox(Protocol):
    """What the conductor needs of the outbox."""

    def publish(self, key: str, report: BaseModel) -> None:
        """Publish a report. Never raises, never waits."""
