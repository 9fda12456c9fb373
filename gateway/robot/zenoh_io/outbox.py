"""The right edge: state, events and frame records to Zenoh, and the token that says that the gateway lives.

A thread of its own publishes. A put waits for each listener whose link is full, a millisecond and more, and for the
routing tables while somebody declares much; on the loop, Stops would wait with it.
"""

import logging
from functools import partial
from typing import Final

import zenoh
from pydantic import BaseModel
from zenoh.handlers import Handler, RingChannel

from gateway.robot.host.worker import Worker
from schemas.keys import ALIVE, GATEWAYS

MOST_WAITING: Final = 1000
"""Reports: some seconds of frames. What comes when so many wait is dropped, since it tells of what is over."""

logger = logging.getLogger(__name__)


class ZenohOutbox:
    """Publishes in the order in which reports come, with congestion control DROP. Silent until it is opened."""

    def __init__(self) -> None:
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._matching: dict[str, zenoh.MatchingListener[Handler[zenoh.MatchingStatus]]] = {}
        self._listened_to: dict[str, bool] = {}
        self.dropped = 0
        """Reports that nobody got, since too many waited."""
        self._told = 0
        """Of these, as the log has them."""
        self._worker = Worker("outbox")

    def open(self, session: zenoh.Session) -> None:
        """From now on, publish here; and say that the gateway lives."""
        self._publishers = {
            key: session.declare_publisher(
                key,
                encoding="application/json",
                congestion_control=zenoh.CongestionControl.DROP,
                allowed_destination=zenoh.Locality.REMOTE,  # the gateway itself receives all keys (unknown_keys.py)
            )
            for key in GATEWAYS
        }
        # Zenoh puts each change into a ring: to look there costs nothing, and waits for none of its tables.
        self._matching = {
            key: publisher.declare_matching_listener(RingChannel(1)) for key, publisher in self._publishers.items()
        }
        self._token = session.liveliness().declare_token(ALIVE)

    def anyone_listens(self, key: str) -> bool:
        """Whether a report would reach anybody. Without this, an idle gateway worked half as much again."""
        listener = self._matching.get(key)
        change = None if listener is None else listener.handler.try_recv()
        if change is not None:
            self._listened_to[key] = change.matching
        return self._listened_to.get(key, False)

    def publish(self, key: str, report: BaseModel) -> None:
        """Send a report to whoever listens. It must not change any more."""
        if key not in self._publishers:
            return
        if self._worker.waiting < MOST_WAITING:
            self._worker.do(partial(self._send, key, report))
        else:
            self.dropped += 1

    def close(self) -> None:
        """Publish what waits, and end the thread. Blocks; not for the loop's thread."""
        self._worker.close()

    def _send(self, key: str, report: BaseModel) -> None:
        try:
            self._publishers[key].put(report.model_dump_json())
        except Exception as error:
            logger.warning("nothing could be published on %s: %s", key, error)
        if self.dropped > self._told and not self._worker.waiting:
            logger.warning("%d reports were not published: too many waited", self.dropped - self._told)
            self._told = self.dropped
