"""Connections without a session to the console, over TLS from another network namespace: STOP ALL comes as at rest.

The bounds are wide, for machines that are busy. Before the
console had a thread for strangers, each of these took it from 0.3 to 4.9 s.
"""

from collections.abc import Iterator

import pytest

from gateway.people.console.app import MAX_CLOSING, MAX_PAGES
from gateway.people.console.server.listener import MAX_SIGNED_IN, MAX_UNKNOWN
from tests.attack.console_listener import CASES, ListenerStand, spread
from tests.benchmarks.processes import fds, rss_kb, threads

pytestmark = [pytest.mark.net, pytest.mark.full, pytest.mark.alone]

PRESSES = 20
USUAL_MS = 100
WORST_MS = 400
OWN = 96
"""Descriptors besides those of connections."""
THREADS = 100
"""The service unit allows 128 (TasksMax)."""
MEMORY_MB = 150
"""It allows 192 (MemoryMax)."""


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ListenerStand]:
    with ListenerStand(tmp_path_factory.mktemp("listener"), ["prlimit", "--nofile=512", "--"]) as running:
        running.press(3)
        yield running


@pytest.mark.parametrize(("kind", "count"), dict(CASES).items())
def test_stop_all_beside_strangers(stand: ListenerStand, kind: str, count: int) -> None:
    with stand.attacked(kind, count):
        took_ms = stand.press(PRESSES)
        pid = stand.console.pid
        taken = fds(pid), threads(pid), rss_kb(pid)
    usual_ms, worst_ms = spread(took_ms)
    assert usual_ms < USUAL_MS
    assert worst_ms < WORST_MS
    descriptors, at_once, memory_kb = taken
    assert descriptors <= MAX_UNKNOWN + MAX_SIGNED_IN + MAX_PAGES + MAX_CLOSING + OWN
    assert at_once < THREADS
    assert memory_kb < MEMORY_MB * 1024
