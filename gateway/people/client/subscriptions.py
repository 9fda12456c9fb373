"""Subscriptions to what a gateway publishes.

Without access control anybody may publish on the gateway's keys: what is no valid report is left out.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final, TypeVar

import zenoh
from pydantic import BaseModel, ValidationError

R = TypeVar("R", bound=BaseModel)

KEPT_EVENTS: Final = 256
"""Events that wait for a reader which is busy; the oldest make way."""


def reports(model: type[R], take: Callable[[R], object]) -> Callable[[zenoh.Sample], None]:
    """A subscriber's callback: `take` gets each report that is valid."""

    def receive(sample: zenoh.Sample) -> None:
        try:
            report = model.model_validate_json(sample.payload.to_bytes())
        except ValidationError:
            return
        take(report)

    return receive


@contextmanager
def subscribed(session: zenoh.Session, handlers: Mapping[str, Any]) -> Iterator[list[Any]]:
    """Subscribers meanwhile, one for each key: a callback, which runs on a thread of Zenoh's, or a channel."""
    subscribers = [session.declare_subscriber(key, handler) for key, handler in handlers.items()]
    try:
        yield subscribers
    finally:
        for subscriber in subscribers:
            with suppress(zenoh.ZError):
                subscriber.undeclare()
