"""The types that core and transports share: messages, replies, reports. No Zenoh, so the transport is replaceable."""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, TypeVar, dataclass_transform

from pydantic import BaseModel

from schemas.keys import CommandKey

T = TypeVar("T")
Reply = Callable[[bytes], None]
"""Sends the answer to one query. Never waits."""


# mutants accepted (LeaveOut, RemoveDecorator, TrueWithFalse): for the type checker, and for speed
@dataclass_transform(frozen_default=True)
def value(cls: type[T]) -> type[T]:
    """Make a dataclass that is frozen for the type checker only: freezing at run time takes four times as long."""
    return dataclass(slots=True)(cls)


class Verb(StrEnum):
    """How a message was sent."""

    PUT = "put"
    DELETE = "delete"
    GET = "get"
    LOST = "lost"
    """At least `size` puts were lost before the next messages. A Stop may be among them."""


@value
class Received:
    """A received message. `size` is the payload's, in bytes; a payload that is too large is not copied from Zenoh.

    `key` is the command key, `expression` the sender's key expression: a wildcard, or an unknown key.
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


class Messages:  # mutants accepted (FalseWithTrue, Step): nothing is taken before the inbox is connected
    """The inbox, as the conductor uses it. By itself, no messages."""

    def __init__(self) -> None:
        self.estops: deque[Received] = deque()
        """Emergency stops that are not carried out yet. The state's owner empties this queue before each message."""
        self.instant_open = False
        """Whether the next messages are of the same instant as the last."""
        self.passed_over = 0
        """How many messages newer ones of their key have displaced before they were read one by one."""

    def take(self) -> Iterable[Received]:
        """Return the other received messages, in the order in which they apply."""
        return ()


class Outbox(Protocol):
    """The outbox, as the conductor uses it."""

    def publish(self, key: str, report: BaseModel) -> None:
        """Publish a report. Never raises, never waits."""
