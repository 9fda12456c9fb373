"""Replies to queries are sent by a thread of their own: a laptop that asks and does not read must not hold the loop.

An answer, and the end of a query, wait while the asker's link is full, until Zenoh closes that link
(`wait_before_close`, see session.py). On the loop that was 5 s without a watchdog, measured with one laptop that asked
100 times a second and read nothing.
"""

import logging

import zenoh

from gateway.robot.core.message import Reply
from gateway.robot.host.worker import Worker

logger = logging.getLogger(__name__)


class ReplySender(Worker):
    """Sends answers, and ends queries, in the order in which they come. Nothing here blocks its caller but `close`."""

    def __init__(self, name: str) -> None:
        super().__init__(name, priority=None)

    def to(self, query: zenoh.Query, key: str) -> Reply:
        """A function that answers this query, once; until then its asker waits."""

        def send(payload: bytes) -> None:
            try:
                with query:  # an asker waits as long as anyone holds its query
                    query.reply(key, payload, encoding="application/json")
            except zenoh.ZError as error:
                logger.warning("a reply on %s could not be sent: %s", key, error)

        return lambda payload: self.do(lambda: send(payload))

    def let_go(self, query: zenoh.Query) -> None:
        """End a query that is answered elsewhere. The last to let go of it sends its end, which may wait as well."""
        self.do(query.drop)
