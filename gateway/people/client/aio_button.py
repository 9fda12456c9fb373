"""A stop button for asyncio."""

from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from gateway.people.client.button import Button
from schemas.telemetry import Ack

if TYPE_CHECKING:
    from schemas.button import ButtonAck


class AsyncButton:
    """`Button` for asyncio: the same rules, errors and names.

    >>> import asyncio
    >>> from gateway.client import AsyncClient
    >>> async def main():
    ...     async with AsyncClient(endpoint) as robot, robot.button("kitchen") as button:
    ...         print((await button.alive()).alive)
    >>> asyncio.run(main())
    1
    """

    def __init__(self, button: Button, run: Callable[..., Awaitable[Any]]) -> None:
        """Made by `AsyncClient.button`; `run` runs what waits on a thread."""
        self._button = button
        self._run = run

    @property
    def name(self) -> str:
        """See `Button.name`."""
        return self._button.name

    @property
    def timeout_ms(self) -> float:
        """See `Button.timeout_ms`."""
        return self._button.timeout_ms

    async def register(self) -> None:
        """See `Button.register`."""
        await self._run(self._button.register)

    async def alive(self) -> "ButtonAck":
        """See `Button.alive`."""
        ack: ButtonAck = await self._run(self._button.alive)
        return ack

    async def press(self) -> Ack:
        """See `Button.press`."""
        ack: Ack = await self._run(self._button.press, stops=True)
        return ack

    async def __aenter__(self) -> Self:
        await self._run(self._button.register, too_late=lambda _: self._button.leave())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._run(self._button.leave)
