"""The lease for asyncio."""

from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import Any, Self

from gateway.errors import LeaseLostError
from gateway.people.client.lease import Lease


class AsyncLease:
    """`Lease` for asyncio: the same rules, errors and names.

    >>> import asyncio
    >>> from gateway.client import AsyncClient
    >>> async def main():
    ...     async with AsyncClient(endpoint, source="anna") as robot, robot.lease() as lease:
    ...         print((await robot.start_leg(3, 90, 45, 120)).accepted, lease.holder)
    >>> asyncio.run(main())
    True anna
    """

    def __init__(self, lease: Lease, run: Callable[..., Awaitable[Any]]) -> None:
        """Made by `AsyncClient.lease`; `run` runs what waits on a thread."""
        self._lease = lease
        self._run = run

    @property
    def held(self) -> bool:
        """See `Lease.held`."""
        return self._lease.held

    @property
    def holder(self) -> str:
        """See `Lease.holder`."""
        return self._lease.holder

    @property
    def verified(self) -> bool:
        """See `Lease.verified`."""
        return self._lease.verified

    @property
    def lost(self) -> LeaseLostError | None:
        """See `Lease.lost`."""
        return self._lease.lost

    async def hand_over(self, to: str) -> None:
        """See `Lease.hand_over`."""
        await self._run(self._lease.hand_over, to)

    async def __aenter__(self) -> Self:
        await self._run(self._lease.acquire, too_late=lambda _: self._lease.release())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._run(self._lease.release)
