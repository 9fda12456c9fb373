"""Subscriptions to a gateway's reports. Invalid ones are skipped: without access control any program may publish."""

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Final, TypeVar
from weakref import WeakMethod

import zenoh
from pydantic import BaseModel, ValidationError

from schemas import keys
from schemas.config import ConfigReport
from schemas.gateway_state import GatewayState
from schemas.state import StateReport, joined

R = TypeVar("R", bound=BaseModel)
T = TypeVar("T")

KEPT_EVENTS: Final = 256
"""The events kept for a busy reader; the oldest are dropped first."""
_ASK_AGAIN_S: Final = 0.2
"""Pause between questions for the configuration (two states), which bounds them in a flood of forged states."""
_ANSWER_S: Final = 1.0
NO_CONFIG: Final = (
    "hexapod/state is answered and hexapod/config is not: the access rules are of an older release; "
    "on the robot, `sudo hexapod-gateway check` names their file"
)


class States:
    """Joins each state with its configuration, and asks for an unknown configuration. For any thread; nothing waits.

    Until the answer, states with that configuration are skipped.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self.config: ConfigReport | None = None
        self._session = session
        self._asked_s = -_ASK_AGAIN_S

    def join(self, payload: bytes) -> GatewayState | None:
        """Return the state with this payload, or None while its configuration is unknown. Raises ValidationError."""
        state = StateReport.model_validate_json(payload)
        config = self.config
        if config is not None and config.config == state.config:
            return joined(state, config)
        now_s = time.monotonic()
        if now_s - self._asked_s >= _ASK_AGAIN_S:
            self._asked_s = now_s
            with suppress(zenoh.ZError):  # the session is closed
                self._session.get(keys.CONFIG, partial(self._receive, state.config), timeout=_ANSWER_S)
        return None

    def _receive(self, wanted: str, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            with suppress(ValidationError):
                config = ConfigReport.model_validate_json(reply.ok.payload.to_bytes())
                if config.config == wanted:  # else it has changed again, or another program answers
                    self.config = config


def reads(read: Callable[[bytes], R | None], take: Callable[[R], object]) -> Callable[[zenoh.Sample], None]:
    """Return a subscriber's callback that calls `take` with what `read` finds, unless it raises ValidationError."""

    def receive(sample: zenoh.Sample) -> None:
        try:
            found = read(sample.payload.to_bytes())
        except ValidationError:
            return
        if found is not None:
            take(found)

    return receive


def weakly(method: Callable[[T], None]) -> Callable[[T], None]:
    """Return a callback for Zenoh that does not keep the method's object alive, which Python cannot find there."""
    found = WeakMethod(method)

    def call(argument: T) -> None:
        if (own := found()) is not None:
            own(argument)

    return call


def undeclare(subscribers: list[Any]) -> None:
    """End these subscriptions, also of a closed session, and empty the list."""
    while subscribers:
        with suppress(zenoh.ZError):
            subscribers.pop().undeclare()
