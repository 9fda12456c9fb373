"""The lease and the stop button of one page. Their tokens stay here, bound to one WebSocket.

The lease's token is added to the page's commands. Only the page's own requests renew the lease, so a page that is
frozen or hidden loses it. It is released when the WebSocket ends. After a loss, commands keep the old token until the
page asks for the lease anew: the gateway then rejects what the page sends by mistake, also while nobody has it.

Each check-in of the button is sent by the page itself, too: a page that is frozen, hidden or gone is silent, and the
gateway stops the robot.
"""

import asyncio
import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from gateway.errors import GatewayError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import NOT_OURS, RELEASE_S
from gateway.people.console.pages.page_messages import DriveRequest, Message, StopButtonRequest
from gateway.people.console.pages.page_tasks import PageTasks
from schemas.ack import Ack
from schemas.button import ButtonAck
from schemas.lease import LeaseAck
from schemas.words import Reason

RENEW_S: Final = 1.0
"""How long a renewal waits for its answer."""
MAX_REQUESTS: Final = 9
"""Most requests of one page: one under way, and eight that wait."""


class PageLease:
    """On the event loop; questions to the gateway wait on threads."""

    def __init__(self, client: Callable[[], Client], name: str, send: Callable[[Message], None]) -> None:
        """`client` raises GatewayError while there is no session. `name` is the page's."""
        self._client = client
        self.name = name
        self.send = send
        self.tasks = PageTasks(MAX_REQUESTS, "requests for the lease", in_turn=True)
        self.mine = False
        """Whether the page drives."""
        self.token: str | None = None
        """The lease token for the page's commands; None without the lease."""
        self._kept_s = self._asked_s = -math.inf
        """When the page sent its latest request that was granted, and when its latest one was answered, monotonic."""
        self._ttl_s = math.inf
        self._doubted = False
        """Whether the gateway is being asked about the lease, because it rejected a command."""

    def go_on(self) -> None:
        """After a reload: inform the page that it still drives, or acquire the lease again if nobody has it."""
        if self.mine:
            ttl_ms = self._ttl_s * 1000 if self._ttl_s < math.inf else None
            self.send({"type": "lease", "mine": True, "ttl_ms": ttl_ms})
        else:
            self.ask(DriveRequest(type="lease", id=0, do="acquire"))

    def ask(self, request: DriveRequest) -> None:
        """Do what the page requests, and send it the answer."""
        self.tasks.start(self._run(request))

    def judge(self, ack: Ack) -> None:
        """Take the answer to a command that carried the token: if it was rejected for its lease, ask who has it."""
        if self.mine and not self._doubted and not ack.accepted and ack.reason in NOT_OURS:
            self._doubted = True
            self.tasks.start(self._run(DriveRequest(type="lease", id=0, do="renew"), by_page=False))

    def close(self) -> None:
        """Release the lease if the closed page has it."""
        self.tasks.start(self._release())

    async def _run(self, request: DriveRequest, *, by_page: bool = True) -> None:
        before_s, asked_s = self._asked_s, time.monotonic()
        try:
            ack = await self._asked(request)
            answer = ack.model_dump(exclude={"nonce", "lease"})  # a page must not learn the token
            lost = self.mine and request.do == "renew" and not ack.accepted
        except GatewayError as error:
            ack, answer = None, {"detail": str(error)}
            lost = self.mine and time.monotonic() - self._kept_s > self._ttl_s + RENEW_S
        finally:
            self._doubted = False
            if by_page:
                self._asked_s = time.monotonic()  # and until now it has waited for the answer
        if lost:
            self.mine = False
            silent = asked_s - before_s > self._ttl_s
            answer["end"] = "page_silent" if silent else "taken" if answer.get("holder") else "gateway"
            answer["silent_s"] = asked_s - self._kept_s
        elif ack is not None and ack.accepted:
            self._kept_s, self._ttl_s = asked_s, (ack.ttl_ms or math.inf) / 1000
            if request.do in ("acquire", "take"):
                self.token, self.mine = ack.lease, ack.lease is not None
        if request.do == "release" and ack is not None and (ack.accepted or not self.mine):
            self.token, self.mine = None, False
        self.send({"type": "lease", **answer, "mine": self.mine, "id": request.id})

    async def _asked(self, request: DriveRequest) -> LeaseAck:
        requests, token = self._client().requests, self.token
        if request.do in ("renew", "release"):
            if token is None:
                return LeaseAck(accepted=False, reason=Reason.NOT_HOLDER, detail="this page does not have the lease")
            if request.do == "renew":
                return await asyncio.to_thread(requests.renew, token, RENEW_S)
            return await asyncio.to_thread(requests.release, token, request.to)
        return await asyncio.to_thread(requests.as_person, request.do, self.name)

    async def _release(self) -> None:
        token, mine = self.token, self.mine
        self.token, self.mine = None, False
        if token is not None and mine:
            with suppress(GatewayError):  # a lease that stays unreleased expires
                await asyncio.to_thread(self._client().requests.release, token, None, RELEASE_S)


CHECK_IN_S: Final = 1.0
"""How long a check-in waits for its answer; meanwhile only the page's newest request is kept."""
NO_TOKEN: Final = "0" * 32
"""The token of no button: the gateway answers `unknown_button`."""


class StopButton:
    """On the event loop; questions to the gateway wait on threads."""

    def __init__(self, client: Callable[[], Client], name: str, send: Callable[[Message], None]) -> None:
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
            answer: dict[str, Any]
            try:
                ack = await asyncio.to_thread(self._ask, message)
            except (GatewayError, RuntimeError) as error:  # RuntimeError: the system allows no further thread
                answer = {"detail": str(error)}
            else:
                answer = {**ack.model_dump(exclude={"nonce", "button"}), "name": self.name}
                if ack.accepted and ack.button is not None:
                    self._token, self._count = ack.button, 0
            self._send({"type": "button", **answer, "id": message.id, "do": message.do})
        self._task = None

    def _ask(self, message: StopButtonRequest) -> ButtonAck:
        requests = self._client().requests
        if message.do == "register":
            return requests.register(self.name, message.sent_ms)
        token = self._token or NO_TOKEN
        if message.do == "leave":
            self._token = None
            return requests.leave(token, CHECK_IN_S)
        self._count += 1
        return requests.check_in(token, self._count, message.sent_ms, CHECK_IN_S)
