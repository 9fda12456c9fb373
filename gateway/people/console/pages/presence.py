"""The status of the link to the gateway, as pages show it. Pure."""

from collections.abc import Sequence

from gateway.people.console.pages.page_messages import LinkMessage


class GatewayPresence:
    """`link` is the newest message to the pages; the methods record events."""

    def __init__(self) -> None:
        self.link = LinkMessage(status="gone")
        self._ended = False
        """Whether its liveliness token is gone."""

    def not_opened(self, why: str) -> None:
        """Record why no session could be opened yet."""
        self.link = LinkMessage(status="gone", detail=self.link.detail or why)

    def diagnosed(self, reasons: Sequence[str]) -> None:
        """Record why no state is received, one reason for each host."""
        if self.link.status != "connected":
            self.link = LinkMessage(status=self.link.status, detail="\n".join(reasons))

    def received_token(self, alive: bool) -> None:
        """Record that the gateway's liveliness token has appeared or gone."""
        self._ended = not alive
        if not alive:
            self.link = LinkMessage(status="gone", detail="the gateway has ended, or the link to it has")

    def received_state(self) -> None:
        """Record a state. After the token has gone, a late state does not reconnect the link."""
        if not self._ended:
            self.link = LinkMessage(status="connected")

    def fell_silent(self, *, linked: bool) -> None:
        """Record a long silence. `linked`: connected to the gateway or to a router in front of it."""
        if not linked:
            self.link = LinkMessage(status="gone", detail=self.link.detail or "the link to the gateway is lost")
        elif not self._ended:
            self.link = LinkMessage(status="silent", detail=self.link.detail or "the gateway is silent; it may hang")
