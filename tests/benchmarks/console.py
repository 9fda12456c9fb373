"""The console with fifty pages, one of them frozen and one flooding: how old is the others' state, how soon STOP ALL?

`python -m tests.benchmarks.console` prints the figures. The pages are WebSockets of this process, on loopback, so what
it says includes their own processing, and a browser's drawing not. The flood comes from a process of its own.
"""

import asyncio
import itertools
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from tests.benchmarks.processes import rss_kb
from tests.support.child import Child
from tests.support.console_process import Console, SignedIn
from tests.support.gateway_process import Gateway

PAGES: Final = 50
STOP_EVERY_S: Final = 0.1


@dataclass(frozen=True)
class Figures:
    """Milliseconds, and the console's memory in MB before the pages were opened and at the end."""

    state_age_ms: Sequence[float]
    stop_ms: Sequence[float]
    stop_round_trip_ms: Sequence[float]
    before_mb: float
    after_mb: float
    floods_ended: int

    def __str__(self) -> str:
        return "\n".join(
            (
                f"state, just before the next one came, {len(self.state_age_ms)} times: {_spread(self.state_age_ms)}",
                f"STOP ALL, there and back, {len(self.stop_ms)} times: {_spread(self.stop_ms)}",
                f"the same with the gateway's own latency: {_spread(self.stop_round_trip_ms)}",
                f"console's memory: {self.before_mb:.0f} MB before, {self.after_mb:.0f} MB after; "
                f"floods ended: {self.floods_ended}",
            )
        )


def p99(values: Sequence[float]) -> float:
    """The value that 99 of 100 do not exceed."""
    return statistics.quantiles(values, n=100)[98]


def _spread(values: Sequence[float]) -> str:
    return f"p50 {statistics.median(values):.1f} ms, p99 {p99(values):.1f} ms, at most {max(values):.1f} ms"


def measure(folder: Path, seconds: float, pages: int = PAGES) -> Figures:
    """Start a gateway and a console, and look for so long."""
    with Gateway(folder) as gateway, Console(folder, "--connect", gateway.endpoint) as console:
        before_mb = rss_kb(console.child.pid) / 1024
        session = console.sign_in()
        crowd = _Crowd(console.url, session)
        flood = Child([sys.executable, "-m", "tests.benchmarks.console", console.url, *session], os.environ)
        flood.wait_for_output("floods")
        asyncio.run(crowd.run(seconds, pages))
        after_mb = rss_kb(console.child.pid) / 1024
        flood.close()
        floods = flood.stdout.count("ended")
        return Figures(crowd.ages_ms, crowd.stops_ms, crowd.round_trips_ms, before_mb, after_mb, floods)


class _Crowd:
    """All pages; `ages_ms` are of those that read."""

    def __init__(self, url: str, session: SignedIn) -> None:
        self._url = url
        self._session = session
        self.ages_ms: list[float] = []
        self.stops_ms: list[float] = []
        self.round_trips_ms: list[float] = []

    async def run(self, seconds: float, pages: int) -> None:
        async with AsyncExitStack() as stack:
            page = partial(open_page, self._url, self._session)
            sockets = [await stack.enter_async_context(page()) for _ in range(pages - 1)]
            frozen, stopping, *reading = sockets
            await frozen.send(json.dumps({"type": "alive", "now_ms": 0}))  # and never a recv
            tasks = [asyncio.create_task(each) for each in map(self._read, reading)]
            with suppress(TimeoutError):
                async with asyncio.timeout(seconds):
                    await self._stop_again_and_again(stopping)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _read(self, socket: ClientConnection) -> None:
        made: datetime | None = None
        async for text in socket:
            message = json.loads(text)
            if message["type"] != "state":
                continue
            if made is not None:
                self.ages_ms.append((datetime.now(UTC) - made).total_seconds() * 1000)
            made = datetime.fromisoformat(message["state"]["time"])

    async def _stop_again_and_again(self, socket: ClientConnection) -> None:
        for number in itertools.count():
            began_s = time.perf_counter()
            await socket.send(json.dumps({"type": "stop_all", "id": number}))
            while True:
                message = json.loads(await socket.recv())
                if message["type"] == "stop" and message["id"] == number and message["answered"]:
                    break
            round_trip_ms = (time.perf_counter() - began_s) * 1000
            self.round_trips_ms.append(round_trip_ms)
            self.stops_ms.append(round_trip_ms - message["latency_us"] / 1000)
            await asyncio.sleep(STOP_EVERY_S)


@asynccontextmanager
async def open_page(url: str, session: SignedIn) -> AsyncIterator[ClientConnection]:
    """A page's WebSocket. What nobody reads waits in the kernel."""
    async with connect(
        url.replace("http", "ws", 1) + "/ws",
        additional_headers={"Cookie": session.cookie, "Origin": url},
        subprotocols=session.subprotocols(url),
        compression=None,
        max_queue=1,
        close_timeout=0.1,
    ) as socket:
        yield socket


async def flood(url: str, session: SignedIn) -> None:
    """Sends as fast as it can and reads nothing; is thrown out, and comes again."""
    print("floods", flush=True)
    while True:
        with suppress(ConnectionClosed):
            async with open_page(url, session) as socket:
                while True:
                    await socket.send(json.dumps({"type": "alive", "now_ms": time.perf_counter() * 1000}))
        print("ended", flush=True)
        await asyncio.sleep(0.2)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        asyncio.run(flood(sys.argv[1], SignedIn(*sys.argv[2:])))
    with tempfile.TemporaryDirectory() as here:
        print(measure(Path(here), 30.0))
