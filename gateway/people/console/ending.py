"""The console's own certificate is revoked: nobody's page is to go on as if it could still drive."""

import asyncio
import logging
import re
from collections.abc import Callable

from gateway.people.console.link import Listener
from gateway.people.console.messages import LinkMessage
from schemas.telemetry import BodyReport, Event, GatewayState, Kind

_WORDS = re.compile(r"[^\s,:]+")

logger = logging.getLogger(__name__)


class EndsWithCertificate:
    """Passes on all that is received, and ends all sessions when the gateway says that this certificate is revoked.

    It says so before it lets go of the connection. A console that is not connected then gets in no more, so its pages
    show no robot.
    """

    def __init__(self, listener: Listener, common_name: str, end_sessions: Callable[[], int]) -> None:
        """`end_sessions` writes a file, so it is called on a thread."""
        self._listener = listener
        self._common_name = common_name
        self._end_sessions = end_sessions
        self._ending: asyncio.Future[int] | None = None

    def received_state(self, state: GatewayState, received_ns: int) -> None:
        """As Listener."""
        self._listener.received_state(state, received_ns)

    def received_body(self, body: BodyReport) -> None:
        """As Listener."""
        self._listener.received_body(body)

    def received_event(self, event: Event, left_out: int) -> None:
        """As Listener."""
        self._listener.received_event(event, left_out)
        if event.kind == Kind.REVOKED and self._common_name in _WORDS.findall(event.detail):
            logger.warning("this console's certificate (%s) is revoked: all its sessions end", self._common_name)
            self._ending = asyncio.ensure_future(asyncio.to_thread(self._end_sessions))

    def link_changed(self, link: LinkMessage) -> None:
        """As Listener."""
        self._listener.link_changed(link)
