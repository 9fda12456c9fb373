"""Connections without a session to the console, over TLS: STOP ALL comes as at rest.

The bound is wide, and grows with what a press takes at rest on a machine that is busy: before the console had a thread
for strangers, a press took from 0.3 to 4.9 s. Only the median is judged: one press may meet a pause of the machine.

    python -m tests.attack.test_console_strangers KIND PORT

connects again and again until killed. KIND is a name in `KINDS`. It prints how many connections have been made so far.
Strangers stand for other machines, so their process leaves this one's processors to others (nice 15).
"""

import asyncio
import os
import resource
import ssl
import statistics
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final, NamedTuple

import pytest

from gateway import certs
from gateway.people.console.serve import MAX_CLOSING, MAX_PAGES
from gateway.people.console.server.listener import MAX_CONNECTIONS
from tests.benchmarks.processes import fds, rss_kb, threads
from tests.support.child import Child
from tests.support.console_process import Console, Page, sign_in
from tests.support.gateway_process import Gateway

pytestmark = [pytest.mark.full, pytest.mark.alone]

HOST: Final = "127.0.0.1"
PRESSES: Final = 20
PAUSE_S: Final = 0.05
USUAL_MS: Final = 250
TIMES: Final = 5
"""The median of presses at rest may be multiplied by this, where the bound is exceeded."""
OWN: Final = 96
"""Descriptors besides those of connections."""
THREADS: Final = 100
"""The service unit allows 128 (TasksMax)."""
MEMORY_MB: Final = 150
"""It allows 192 (MemoryMax)."""


class Kind(NamedTuple):
    """What a stranger sends on a connection, on which it then waits until the other side closes."""

    at_once: int
    """So many connections."""
    head: bytes = b""
    shakes_hands: bool = False
    """It makes a TLS connection."""
    goes_on: bool = False
    """Behind the head it sends a byte at a time; an answer alone does not end that."""
    leaves: bool = False
    """It does not wait."""


KINDS: Final = {
    "silent": Kind(700),
    "half_open": Kind(700, bytes.fromhex("16030102000100") + bytes(200)),  # the rest of this handshake does not come
    "handshake": Kind(50, shakes_hands=True, leaves=True),
    "slow_headers": Kind(200, b"GET / HTTP/1.1\r\nHost: %b\r\nX-Slow: ", shakes_hands=True, goes_on=True),
    "get": Kind(50, b"GET / HTTP/1.1\r\nHost: %b\r\nCookie: hexapod-console-8080=nonsense\r\n\r\n", shakes_hands=True),
    "garbage": Kind(100, os.urandom(3000).replace(b"%", b"")),
}


async def connect(kind: Kind, port: int, context: ssl.SSLContext, made: list[int]) -> None:
    """Make one connection of this kind, and append it to `made`."""
    reader, writer = await asyncio.open_connection(HOST, port, ssl=context if kind.shakes_hands else None)
    made[0] += 1
    answer = asyncio.create_task(reader.read())
    with suppress(OSError):
        writer.write(kind.head.replace(b"%b", f"{HOST}:{port}".encode()))
        while kind.goes_on and not answer.done():
            writer.write(b"x")
            await writer.drain()
            await asyncio.sleep(0.005)
        if not kind.leaves:
            await answer
    writer.transport.abort()
    answer.cancel()


async def attack(kind: Kind, port: int) -> None:
    """Connect again and again, without end."""
    made, context = [0], ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE

    async def again_and_again() -> None:
        while True:
            with suppress(OSError, EOFError):
                await connect(kind, port, context, made)
            await asyncio.sleep(0)

    tasks = [asyncio.create_task(again_and_again()) for _ in range(kind.at_once)]
    while True:
        await asyncio.wait(tasks, timeout=0.3)
        print("made", *made, flush=True)


@contextmanager
def strangers(kind: str, port: int) -> Iterator[None]:
    program = [sys.executable, "-m", "tests.attack.test_console_strangers", kind, str(port)]
    with Child(program, os.environ) as child:
        child.wait_for_output("made ", 20)
        yield


class Stand(NamedTuple):
    """A console with few descriptors, and a page that is signed in."""

    console: Console
    page: Page

    def press(self, times: int = PRESSES) -> list[float]:
        """Return how long each took until the gateway had confirmed it, in ms."""
        took_ms = []
        for _ in range(times):
            self.page.send(type="alive", now_ms=self.page.now_ms())
            began_s = time.perf_counter()
            self.page.stop_all()
            took_ms.append((time.perf_counter() - began_s) * 1000)
            threading.Event().wait(PAUSE_S)
        return took_ms


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    folder = tmp_path_factory.mktemp("stand")
    made = folder / "certs"
    certs.folder.init(made, [HOST])
    certs.folder.issue(made, "web", "console", hosts=[HOST])
    files = (f"--cert={made}/web.pem", f"--key={made}/web.key")
    few = ("prlimit", "--nofile=512", "--")
    verify = ssl.create_default_context(cafile=made / "web-ca.pem")
    with (
        Gateway(folder) as gateway,
        Console(folder, *files, "--connect", gateway.endpoint, address="0.0.0.0", prefix=few) as console,  # noqa: S104
        Page(console.url, sign_in(console.new_link(), verify), verify=verify) as page,
    ):
        running = Stand(console, page)
        running.press(3)
        yield running


@pytest.mark.parametrize("kind", KINDS)
def test_stop_all_beside_strangers(stand: Stand, kind: str) -> None:
    rest_ms = stand.press()
    with strangers(kind, stand.console.port):
        took_ms = stand.press()
        pid = stand.console.child.pid
        descriptors, at_once, memory_kb = fds(pid), threads(pid), rss_kb(pid)
    print(f"{kind}: p50 {statistics.median(took_ms):.0f} ms, worst {max(took_ms):.0f} ms")
    assert statistics.median(took_ms) < max(USUAL_MS, TIMES * statistics.median(rest_ms))
    assert descriptors <= MAX_CONNECTIONS + MAX_PAGES + MAX_CLOSING + OWN
    assert at_once < THREADS
    assert memory_kb < MEMORY_MB * 1024


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_NOFILE, (4096, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    os.nice(15)
    asyncio.run(attack(KINDS[sys.argv[1]], int(sys.argv[2])))
