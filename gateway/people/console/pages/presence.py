"""The status of the link to the gateway, as pages show it. Pure: `now_ns` is monotonic."""

from collections.abc import Sequence

from gateway.people.client.silence import Silence
from gateway.people.console.pages.page_messages import LinkMessage


class GatewayPresence:
    """`link` is the newest message to the pages; the methods take what happens."""

    def __init__(self) -> None:
        self.link = LinkMessage(status="gone")
        self._silence = Silence()
        self._ended = False
        """Whether its liveliness token is gone."""

    def opened(self, now_ns: int) -> None:
        """A session is open; its gateway has a second to send a state."""
        self._silence.opened(now_ns)

    def not_opened(self, why: str) -> None:
        """No session could be opened yet."""
        self.link = LinkMessage(status="gone", detail=self.link.detail or why)

    def looked(self, reasons: Sequence[str]) -> None:
        """Why no state comes, one line for each host."""
        if self.link.status != "connected":
            self.link = LinkMessage(status=self.link.status, detail="\n".join(reasons))

    def received_token(self, alive: bool) -> None:
        """The gateway's liveliness token has appeared or gone."""
        self._ended = not alive
        if not alive:
            self.link = LinkMessage(status="gone", detail="the gateway has ended, or the link to it has")

    def received_state(self, now_ns: int) -> None:
        """A state that comes after the token has gone was under way, and does not count."""
        self._silence.received(now_ns)
        if not self._ended:
            self.link = LinkMessage(status="connected")

    def is_silent(self, now_ns: int) -> bool:
        """Whether the newest state is so old that `fell_silent` applies."""
        return self._silence.is_long(now_ns)

    def fell_silent(self, *, linked: bool) -> None:
        """`linked`: connected to the gateway, or to a router in front of it."""
        if not linked:
            self.link = LinkMessage(status="gone", detail=self.link.detail or "the link to the gateway is lost")
        elif not self._ended:
            detail = self.link.detail or "the gateway is silent; it may hang"
            self.link = LinkMessage(status="silent", detail=detail)
