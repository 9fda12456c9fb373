"""The lease of one page: its token stays here, bound to one WebSocket, and goes with that one's commands.

Nothing here renews it but the page's own request, so a page that is frozen or hidden loses it. The WebSocket's end
gives it back. After a loss the old token still goes with the commands, until the page asks anew: so nothing that it
sends by mistake is taken while nobody drives.
"""

import asyncio
import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from gateway.errors import GatewayError
from gateway.people.client.blocking import Client
from gateway.people.client.lease import NOT_OURS
from gateway.people.console.messages import DriveRequest, LeaseMessage
from gateway.people.walking import lease_lost
from schemas.lease import LeaseAck
from schemas.telemetry import Ack, Reason

RENEW_S: Final = 1.0
RELEASE_S: Final = 0.5
MAX_WAITING: Final = 8
"""Requests of one page; they are made one after the other."""


class PageLease:
    """On the event loop; what waits runs on threads."""

    def __init__(self, client: Callable[[], Client], name: str, send: Callable[[LeaseMessage], None]) -> None:
        """`client` raises GatewayError while there is no session. `name` is the page's."""
        self._client = client
        self._name = name
        self._send = send
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._tasks: set[asyncio.Task[None]] = set()
        self.mine = False
        """Whether the page drives."""
        self.token: str | None = None
        """What the page's commands carry."""
        self._kept_s = -math.inf
        """When the page asked last for what has kept the lease."""
        self._ttl_s = math.inf

    @property
    def is_full(self) -> bool:
        """Whether too many requests of the page wait."""
        return self._waiting >= MAX_WAITING

    def ask(self, request: DriveRequest) -> None:
        """Do what the page asks for, and send it what came of it."""
        self._start(request)

    def judge(self, ack: Ack) -> None:
        """What became of a command that carried the token."""
        if self.mine and not ack.accepted and ack.reason in NOT_OURS:
            self.mine = False
            silent = time.monotonic() - self._kept_s > self._ttl_s
            detail = self._why_lost(time.monotonic(), None) if silent else ack.detail
            self._send(LeaseMessage(mine=False, reason=str(ack.reason), detail=detail))

    def close(self) -> None:
        """The page is gone: give it back, if it has it."""
        self._start(None)

    def _start(self, request: DriveRequest | None) -> None:
        self._waiting += 1
        task = asyncio.get_running_loop().create_task(self._run(request))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _run(self, request: DriveRequest | None) -> None:
        async with self._turn:
            self._waiting -= 1
            if request is None:
                await self._give_back()
                return
            asked_s = time.monotonic()
            try:
                ack = await self._asked(request)
            except GatewayError as error:
                self._send(LeaseMessage(mine=self.mine, id=request.id, detail=str(error)))
                return
            if ack.accepted:
                self._kept_s, self._ttl_s = asked_s, (ack.ttl_ms or math.inf) / 1000
            elif self.mine and request.do == "renew":
                ack = ack.model_copy(update={"detail": self._why_lost(asked_s, ack.holder)})
            self._answered(request, ack)

    async def _asked(self, request: DriveRequest) -> LeaseAck:
        requests, token = self._client().lease_requests, self.token
        if request.do in ("renew", "release"):
            if token is None:
                return LeaseAck(accepted=False, reason=Reason.NOT_HOLDER, detail="this page does not have the lease")
            if request.do == "renew":
                return await asyncio.to_thread(requests.renew, token, RENEW_S)
            return await asyncio.to_thread(requests.release, token, request.to)
        return await asyncio.to_thread(requests.as_person, request.do, self._name)

    def _answered(self, request: DriveRequest, ack: LeaseAck) -> None:
        if ack.accepted and request.do in ("acquire", "take"):
            self.token, self.mine = ack.lease, ack.lease is not None
        elif request.do == "release":
            self.token, self.mine = (None, False) if ack.accepted or not self.mine else (self.token, True)
        elif request.do == "renew":
            self.mine = ack.accepted
        # Of the answer it has the fields that a page may know: not the token.
        self._send(LeaseMessage.model_validate({**ack.model_dump(), "mine": self.mine, "id": request.id}))

    def _why_lost(self, now_s: float, holder: str | None) -> str:
        return lease_lost(now_s - self._kept_s, self._ttl_s, holder)

    async def _give_back(self) -> None:
        token, mine = self.token, self.mine
        self.token, self.mine = None, False
        if token is not None and mine:
            with suppress(GatewayError):  # what is not answered expires by itself
                await asyncio.to_thread(self._client().lease_requests.release, token, None, RELEASE_S)
