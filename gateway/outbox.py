"""The right edge: state, events and frame records to Zenoh, and the token that says that the gateway lives."""

import logging
from datetime import UTC, datetime
from typing import Any, Protocol

import zenoh
from pydantic import BaseModel

from schemas.keys import ALIVE, EVENT, FRAME, STATE

logger = logging.getLogger(__name__)


def wall_clock() -> datetime:
    """The time that people read; no decision depends on it."""
    return datetime.now(UTC)


class Outbox(Protocol):
    """What the conductor needs of the right edge."""

    def publish(self, key: str, report: BaseModel) -> None:
        """Send a report to whoever listens. Never raises, never waits."""


class ZenohOutbox:
    """Publishes with congestion control DROP: a frozen listener must not hold the loop. Silent until it is opened."""

    def __init__(self) -> None:
        self._publishers: dict[str, zenoh.Publisher] = {}

    def open(self, session: zenoh.Session) -> None:
        """From now on, publish here; and say that the gateway lives."""
        self._publishers = {
            key: session.declare_publisher(
                key, encoding="application/json", congestion_control=zenoh.CongestionControl.DROP
            )
            for key in (STATE, EVENT, FRAME)
        }
        self._token = session.liveliness().declare_token(ALIVE)

    def anyone_listens(self, key: str) -> bool:
        """Whether a report would reach anybody: without this, an idle gateway worked half as much again."""
        if key not in self._publishers:
            return False
        status: Any = self._publishers[key].matching_status  # Zenoh's type stub takes it for a bool
        return bool(getattr(status, "matching", status))

    def publish(self, key: str, report: BaseModel) -> None:
        """Send a report to whoever listens."""
        try:
            if key in self._publishers:
                self._publishers[key].put(report.model_dump_json())
        except zenoh.ZError as error:
            logger.warning("nothing could be published on %s: %s", key, error)
