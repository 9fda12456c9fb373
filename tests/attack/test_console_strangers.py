"""Connections without a session to the console, over TLS: STOP ALL comes as at rest.

The bound is wide, and grows with what a press takes at rest on a machine that is busy: before the console had a thread
for strangers, a press took from 0.3 to 4.9 s. Only the median is judged: one press may meet a pause of the machine.
"""

import ssl
import statistics
import threading
import time
from collections.abc import Iterator
from typing import Final, NamedTuple

import pytest

from gateway import certs
from gateway.people.console.serve import MAX_CLOSING, MAX_PAGES
from gateway.people.console.server.listener import MAX_CONNECTIONS
from tests.attack.strangers import strangers
from tests.benchmarks.processes import fds, rss_kb, threads
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
CASES: Final = {"silent": 700, "half_open": 700, "handshake": 50, "slow_headers": 200, "get": 50, "garbage": 100}
"""What strangers do, and on how many connections at once."""


class Stand(NamedTuple):
    """A console with few descriptors, and a page that is signed in."""

    console: Console
    page: Page

    def press(self, times: int = PRESSES) -> list[float]:
        """How long each took until the gateway had confirmed it, in ms."""
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


@pytest.mark.parametrize(("kind", "count"), CASES.items())
def test_stop_all_beside_strangers(stand: Stand, kind: str, count: int) -> None:
    rest_ms = stand.press()
    with strangers(kind, stand.console.port, count):
        took_ms = stand.press()
        pid = stand.console.child.pid
        descriptors, at_once, memory_kb = fds(pid), threads(pid), rss_kb(pid)
    print(f"{kind}: p50 {statistics.median(took_ms):.0f} ms, worst {max(took_ms):.0f} ms")
    assert statistics.median(took_ms) < max(USUAL_MS, TIMES * statistics.median(rest_ms))
    assert descriptors <= MAX_CONNECTIONS + MAX_PAGES + MAX_CLOSING + OWN
    assert at_once < THREADS
    assert memory_kb < MEMORY_MB * 1024
