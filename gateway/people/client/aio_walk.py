"""Walking for asyncio."""

from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import Any, Self

from gateway.errors import GatewayError
from gateway.people.client.walk import Walk
from gateway.people.walking import WalkState


class AsyncWalk:
    """`Walk` for asyncio: the same rules, errors and names; for one task at a time.

    >>> import asyncio
    >>> from gateway.client import AsyncClient
    >>> async def main():
    ...     async with AsyncClient(endpoint) as robot, robot.walk(gait="ripple") as walk:
    ...         await walk.stand()
    ...         await walk.go(turn_rad_s=0.2)
    ...         print(walk.state.posture)
    >>> asyncio.run(main())
    walking
    """

    def __init__(self, walk: Walk, run: Callable[..., Awaitable[Any]]) -> None:
        """Made by `AsyncClient.walk`; `run` runs what waits on a thread."""
        self._walk = walk
        self._run = run

    async def go(self, forward_m_s: float = 0.0, left_m_s: float = 0.0, turn_rad_s: float = 0.0) -> None:
        """See `Walk.go`."""
        await self._run(self._walk.go, forward_m_s, left_m_s, turn_rad_s)

    async def stand(self, height_m: float | None = None, roll_rad: float = 0.0, pitch_rad: float = 0.0) -> None:
        """See `Walk.stand`."""
        await self._run(self._walk.stand, height_m, roll_rad, pitch_rad)

    async def sit(self) -> None:
        """See `Walk.sit`."""
        await self._run(self._walk.sit)

    def walk_as(self, gait: str) -> None:
        """See `Walk.walk_as`."""
        self._walk.walk_as(gait)

    async def start_again(self) -> None:
        """See `Walk.start_again`."""
        await self._run(self._walk.start_again)

    @property
    def state(self) -> WalkState:
        """See `Walk.state`."""
        return self._walk.state

    @property
    def hold_s(self) -> float:
        """See `Walk.hold_s`."""
        return self._walk.hold_s

    @hold_s.setter
    def hold_s(self, seconds: float) -> None:
        self._walk.hold_s = seconds

    @property
    def rest_s(self) -> float:
        """See `Walk.rest_s`."""
        return self._walk.rest_s

    @rest_s.setter
    def rest_s(self, seconds: float) -> None:
        self._walk.rest_s = seconds

    async def __aenter__(self) -> Self:
        await self._run(self._walk.open, too_late=lambda _: self._walk.close(sits=False))
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            await self._run(self._end, error is None, stops=True)  # goes on when this is cancelled
        except GatewayError as failed:
            if error is None:
                raise
            error.add_note(f"and the end of the walk: {failed}")

    def _end(self, sits: bool) -> None:
        self._walk.close(sits=sits)
