"""Publishes state, events and frame records on Zenoh, and the gateway's liveliness token.

A background thread publishes: a put waits a millisecond or more for each subscriber whose link is full, and for Zenoh's
tables while a client declares many keys. On the loop, this would delay Stops.
"""

import logging
from functools import partial
from typing import Final

import zenoh
from pydantic import BaseModel
from zenoh.handlers import Handler, RingChannel

from gateway.host.worker import Worker
from schemas.keys import ALIVE, GATEWAYS

MAX_REPORTS_WAITING: Final = 1000
"""Some seconds of frame records. Further reports are dropped, since old reports would delay current ones."""

logger = logging.getLogger(__name__)


class ZenohOutbox:
    """Publishes reports in order, with congestion control DROP. Before `open`, reports are discarded."""

    def __init__(self) -> None:
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._matching: dict[str, zenoh.MatchingListener[Handler[zenoh.MatchingStatus]]] = {}
        self._listened_to: dict[str, bool] = {}
        self._dropped = 0
        self._worker = Worker("outbox")

    def open(self, session: zenoh.Session) -> None:
        """Publish on this session from now on, and declare the liveliness token."""
        self._publishers = {
            key: session.declare_publisher(
                key,
                encoding="application/json",
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,  # the gateway itself receives all keys (unknown_keys.py)
            )
            for key in GATEWAYS
        }
        # Zenoh puts each change of matching into a ring: reading it is cheap, and waits for no table.
        self._matching = {
            key: publisher.declare_matching_listener(RingChannel(1)) for key, publisher in self._publishers.items()
        }
        self._token = session.liveliness().declare_token(ALIVE)

    def anyone_listens(self, key: str) -> bool:
        """Return whether `key` has a subscriber. Without this check, an idle gateway took 1.5 times the processor."""
        listener = self._matching.get(key)
        change = None if listener is None else listener.handler.try_recv()
        if change is not None:
            self._listened_to[key] = change.matching
        return self._listened_to.get(key, False)

    def publish(self, key: str, report: BaseModel) -> None:
        """Queue a report, which must not change afterwards. Does not block."""
        if key not in self._publishers:
            return
        if self._worker.waiting < MAX_REPORTS_WAITING:
            self._worker.do(partial(self._send, key, report))
        else:
            self._dropped += 1

    def close(self) -> None:
        """Publish the queued reports and end the thread. Blocks, so do not call it on the loop's thread."""
        self._worker.close()

    def _send(self, key: str, report: BaseModel) -> None:
        try:
            self._publishers[key].put(report.model_dump_json())
        except Exception as error:
            logger.warning("nothing could be published on %s: %s", key, error)
        if self._dropped and not self._worker.waiting:
            logger.warning("%d reports were not published: too many waited", self._dropped)
            self._dropped = 0
