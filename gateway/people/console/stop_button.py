"""One page that is a stop button: its token stays here, and each check-in is the page's own.

Nothing here checks in by itself: a page that is frozen, hidden or gone is silent, and the gateway stops the robot.
"""

import asyncio
from collections.abc import Callable
from typing import Final

from gateway.errors import GatewayError
from gateway.people.client.blocking import Client
from gateway.people.console.messages import StopButtonMessage, StopButtonRequest
from schemas.button import ButtonAck

ANSWER_S: Final = 1.0
"""For a check-in; a newer one takes the place of one that waits for its turn."""


class StopButton:
    """On the event loop; what waits runs on threads."""

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
        """Do what the page asks for, and answer. Of several that wait, the newest is as good as all."""
        self._next = message
        if self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._run())

    async def _run(self) -> None:
        while (message := self._next) is not None:
            self._next = None
            try:
                ack = await asyncio.to_thread(self._ask, message)
            except (GatewayError, RuntimeError) as error:  # RuntimeError: no thread is to be had
                self._send(StopButtonMessage(id=message.id, do=message.do, detail=str(error)))
            else:
                self._send(self._answered(message, ack))
        self._task = None

    def _ask(self, message: StopButtonRequest) -> ButtonAck:
        """On a thread."""
        requests = self._client().button_requests
        if message.do == "register":
            return requests.register(self.name, message.sent_ms)
        token = self._token or "0" * 32  # of no button: the gateway says so
        if message.do == "leave":
            self._token = None
            return requests.leave(token, ANSWER_S)
        self._count += 1
        return requests.alive(token, self._count, message.sent_ms, ANSWER_S)

    def _answered(self, message: StopButtonRequest, ack: ButtonAck) -> StopButtonMessage:
        if ack.accepted and ack.button is not None:
            self._token, self._count = ack.button, 0
        # Of the answer it has the fields that a page may know: not the token.
        return StopButtonMessage.model_validate(
            {**ack.model_dump(), "id": message.id, "do": message.do, "name": self.name}
        )
