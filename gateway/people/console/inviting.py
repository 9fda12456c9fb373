"""A link for a second device, shown as a QR code by a page that is signed in."""

import asyncio
from collections.abc import Callable

import segno

from gateway.errors import GatewayError
from gateway.people.console.messages import LinkForMessage


class Inviting:
    """For one page, on the event loop: one link at a time."""

    def __init__(self, new_link: Callable[[], str], send: Callable[[LinkForMessage], None]) -> None:
        """`new_link` writes a file, so it is called on a thread."""
        self._new_link = new_link
        self._send = send
        self._task: asyncio.Task[None] | None = None

    def ask(self, number: int) -> None:
        """Make a link and send it; while one is being made, another is not."""
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._run(number))

    async def _run(self, number: int) -> None:
        try:
            url, rows = await asyncio.to_thread(self._make)
        except GatewayError as error:
            self._send(LinkForMessage(id=number, error=str(error)))
        else:
            self._send(LinkForMessage(id=number, url=url, rows=rows))

    def _make(self) -> tuple[str, list[str]]:
        url = self._new_link()
        code = segno.make(url, error="l")
        return url, ["".join(str(module & 1) for module in row) for row in code.matrix]
