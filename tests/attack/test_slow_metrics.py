"""Somebody connects to the metrics, again and again, and says nothing: a scrape is answered, and Stops are on time."""

import socket
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

from schemas.telemetry import Cause
from tests.benchmarks.processes import fds, threads
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import frames
from tests.zenoh.test_metrics import read, value

SILENT = 90
DESCRIPTORS = 260
THREADS = 128
"""What the service unit allows (TasksMax)."""
LATE_MS = 2000
"""A Stop is some 2 ms late at worst; one that waited for a silent connection came seconds later."""


@pytest.mark.parametrize("said", [b"", b"GET /metrics HTTP/1.1\r\nHost: rob"])
def test_silent_connections_keep_no_scrape_out_and_no_stop_waiting(tmp_path: Path, said: bytes) -> None:
    port = free_port()
    address = f"127.0.0.1:{port}"
    settings: dict[str, dict[str, Any]] = {
        "telemetry": {"metrics": address, "frames": True},
        "watchdog": {"timeout_ms": 20},
    }
    limited = ["prlimit", f"--nofile={DESCRIPTORS}", "--"]
    with Gateway(tmp_path, settings, prefix=limited) as gateway, gateway.client() as client, ExitStack() as crowd:
        before, pid = python_threads(gateway), gateway.child.pid
        for _ in range(SILENT):
            crowd.enter_context(socket.create_connection(("127.0.0.1", port), 10)).sendall(said)
        heard = frames(client)
        for count in range(1, 6):
            assert client.start_leg(3, 90, 45, 120).accepted
            heard.wait(lambda frame: frame.cause is Cause.WATCHDOG, count=count)
        assert value(read(address), "hexapod_frames_written_total", cause="watchdog") == 5
        assert python_threads(gateway) == before, "no thread for a connection"
        assert threads(pid) <= THREADS
        assert fds(pid) < DESCRIPTORS - 50
        latency = client.state().watchdog.stop_latency_us
        assert latency.max is not None
        assert latency.max < LATE_MS * 1000


def python_threads(gateway: Gateway) -> int:
    """How many threads are Python's: those of Zenoh have names of their own, and more come on a busy machine."""
    tasks = Path(f"/proc/{gateway.child.pid}/task")
    names = []
    for task in tasks.iterdir():
        with suppress(OSError):  # it has ended
            names.append((task / "comm").read_text())
    return names.count((tasks / str(gateway.child.pid) / "comm").read_text())
