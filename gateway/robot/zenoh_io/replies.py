"""Sends replies from a background thread, so that a client that does not read its replies cannot block the loop.

A reply, and the end of a query, wait while the sender's link is full, until Zenoh closes that link
(`wait_before_close`, see session.py). On the loop that was 5 s without a watchdog, measured with one laptop that sent
100 queries a second and read no reply.
"""

import logging

import zenoh

from gateway.robot.core.message import Reply
from gateway.robot.host.worker import Worker

logger = logging.getLogger(__name__)


class ReplySender(Worker):
    """Sends replies and ends queries in order. Only `close` blocks its caller."""

    def __init__(self, name: str) -> None:
        super().__init__(name, priority=None)

    def to(self, query: zenoh.Query, key: str) -> Reply:
        """A function that replies to this query, once; the client waits until then."""

        def send(payload: bytes) -> None:
            try:
                with query:  # the client waits as long as a reference to its query exists
                    query.reply(key, payload, encoding="application/json")
            except zenoh.ZError as error:
                logger.warning("a reply on %s could not be sent: %s", key, error)

        return lambda payload: self.do(lambda: send(payload))

    def let_go(self, query: zenoh.Query) -> None:
        """Release a query that is answered elsewhere. Releasing the last reference sends its end, which may block."""
        self.do(query.drop)
