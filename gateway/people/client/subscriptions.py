"""Subscriptions to what a gateway publishes.

Without access control any program may publish on the gateway's keys: invalid reports are left out.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final, TypeVar

import zenoh
from pydantic import BaseModel, ValidationError

R = TypeVar("R", bound=BaseModel)

KEPT_EVENTS: Final = 256
"""The events kept for a busy reader; the oldest are dropped first."""


def reports(model: type[R], take: Callable[[R], object]) -> Callable[[zenoh.Sample], None]:
    """A subscriber's callback that calls `take` with each valid report."""

    def receive(sample: zenoh.Sample) -> None:
        try:
            report = model.model_validate_json(sample.payload.to_bytes())
        except ValidationError:
            return
        take(report)

    return receive


@contextmanager
def subscribed(session: zenoh.Session, handlers: Mapping[str, Any]) -> Iterator[list[Any]]:
    """Subscribe to each key for the time of a `with`; a handler is a callback, on a Zenoh thread, or a channel."""
    subscribers = [session.declare_subscriber(key, handler) for key, handler in handlers.items()]
    try:
        yield subscribers
    finally:
        for subscriber in subscribers:
            with suppress(zenoh.ZError):
                subscriber.undeclare()
