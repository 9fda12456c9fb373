"""A page that is a stop button. Its token stays here; each check-in is sent by the page itself.

Nothing here checks in by itself: so a page that is frozen, hidden or gone is silent, and the gateway stops the robot.
"""

import asyncio
from collections.abc import Callable
from typing import Final

from gateway.errors import GatewayError
from gateway.people.client.blocking import Client
from gateway.people.console.pages.page_messages import StopButtonMessage, StopButtonRequest
from schemas.button import ButtonAck

CHECK_IN_S: Final = 1.0
"""How long a check-in waits for its answer; meanwhile only the page's newest request is kept."""
NO_TOKEN: Final = "0" * 32
"""The token of no button: the gateway answers `unknown_button`."""


class StopButton:
    """On the event loop; questions to the gateway wait on threads."""

    def __init__(self, client: Callable[[], Client], name: str, send: Callable[[StopButtonMessage], None]) -> None:
        """`client` raises GatewayError while there is no session. `name` is the page's."""
        self._client = client
        self.name = name
        self._send = send
        self._token: str | None = None
        self._count = 0
        self._next: StopButtonRequest | None = None
        self._task: asyncio.Task[None] | None = None

    def take(self, message: StopButtonRequest) -> None:
        """Do what the page requests, and answer. A newer request replaces one that waits."""
        self._next = message
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def _run(self) -> None:
        while (message := self._next) is not None:
            self._next = None
            try:
                ack = await asyncio.to_thread(self._ask, message)
            except (GatewayError, RuntimeError) as error:  # RuntimeError: the system allows no further thread
                self._send(StopButtonMessage(id=message.id, do=message.do, detail=str(error)))
            else:
                self._send(self._answered(message, ack))
        self._task = None

    def _ask(self, message: StopButtonRequest) -> ButtonAck:
        requests = self._client().button_requests
        if message.do == "register":
            return requests.register(self.name, message.sent_ms)
        token = self._token or NO_TOKEN
        if message.do == "leave":
            self._token = None
            return requests.leave(token, CHECK_IN_S)
        self._count += 1
        return requests.alive(token, self._count, message.sent_ms, CHECK_IN_S)

    def _answered(self, message: StopButtonRequest, ack: ButtonAck) -> StopButtonMessage:
        if ack.accepted and ack.button is not None:
            self._token, self._count = ack.button, 0
        # StopButtonMessage ignores the token, which a page must not learn.
        own = {"id": message.id, "do": message.do, "name": self.name}
        return StopButtonMessage.model_validate({**ack.model_dump(), **own})
