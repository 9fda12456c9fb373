"""Somebody connects to the metrics, again and again, and says nothing: a scrape is answered, and Stops are on time."""

import os
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from gateway.client import Client
from gateway.robot.runtime.metrics_page import MOST_A_SECOND, WAITING
from schemas.telemetry import Cause
from tests.support.gateway_process import Gateway, free_port
from tests.support.heard import frames
from tests.zenoh.test_metrics import read, value

SILENT = 90
DESCRIPTORS = 260
READERS = 80
READ_S = 3.0
"""Enough for a gateway, which asks for 216."""
THREADS = 64
"""What the service unit allows (TasksMax)."""
LATE_MS = 100
"""Generous: a Stop is some 2 ms late at worst, also on a busy machine that gives real-time priority."""


class Crowd:
    """Connections that send `said`, and nothing more."""

    def __init__(self, address: tuple[str, int], said: bytes) -> None:
        self._address = address
        self._said = said
        self._stack = ExitStack()

    def connect(self, count: int) -> None:
        for _ in range(count):
            connection = self._stack.enter_context(socket.create_connection(self._address, 10))
            connection.sendall(self._said)

    def close(self) -> None:
        self._stack.close()


@contextmanager
def attacked(folder: Path, said: bytes) -> Iterator[tuple[Gateway, str, Crowd]]:
    """A gateway, the address of its metrics, and a crowd at that address."""
    port = free_port()
    address = f"127.0.0.1:{port}"
    settings: dict[str, dict[str, Any]] = {
        "telemetry": {"metrics": address, "frames": True},
        "watchdog": {"timeout_ms": 20, "repeats": 0},
    }
    limited = ["prlimit", f"--nofile={DESCRIPTORS}", "--"]
    crowd = Crowd(("127.0.0.1", port), said)
    with Gateway(folder, settings, prefix=limited) as gateway:
        try:
            yield gateway, address, crowd
        finally:
            crowd.close()


@pytest.mark.parametrize("said", [b"", b"GET /metrics HTTP/1.1\r\nHost: rob"])
def test_silent_connections_keep_no_scrape_out_and_no_stop_waiting(tmp_path: Path, said: bytes) -> None:
    with attacked(tmp_path, said) as (gateway, address, crowd), gateway.client() as client:
        before = threads(gateway)
        crowd.connect(SILENT)
        let_expire(client, 5)
        samples = read(address)
        assert value(samples, "hexapod_frames_written_total", cause="watchdog") == 5
        assert threads(gateway) == before, "no thread for a connection"
        assert len(os.listdir(f"/proc/{gateway.child.pid}/task")) <= THREADS
        assert len(os.listdir(f"/proc/{gateway.child.pid}/fd")) < DESCRIPTORS - 50
        latency = client.state().watchdog.stop_latency_us
        assert latency.max is not None
        assert latency.max < LATE_MS * 1000


def threads(gateway: Gateway) -> int:
    """How many threads are Python's: those of Zenoh have names of their own, and more come on a busy machine."""
    tasks = Path(f"/proc/{gateway.child.pid}/task")
    names = []
    for task in tasks.iterdir():
        with suppress(OSError):  # it has ended
            names.append((task / "comm").read_text())
    return names.count((tasks / str(gateway.child.pid) / "comm").read_text())


def let_expire(client: Client, times: int) -> None:
    """Have the watchdog stop a leg so many times."""
    heard = frames(client)
    for count in range(1, times + 1):
        assert client.start_leg(3, 90, 45, 120).accepted
        heard.wait(lambda frame: frame.cause is Cause.WATCHDOG, count=count)


def test_who_asks_again_and_again_is_answered_so_often_a_second_and_no_more(tmp_path: Path) -> None:
    """80 slow readers, each of which connects anew as soon as its connection ends."""
    with attacked(tmp_path, b"") as (gateway, address, _), gateway.client() as client:
        host, _, port = address.rpartition(":")
        before, until_s = threads(gateway), time.monotonic() + READ_S
        with ThreadPoolExecutor(READERS) as pool:
            counts = [pool.submit(answered, (host, int(port)), until_s) for _ in range(READERS)]
            let_expire(client, 5)
            assert threads(gateway) == before
        answers = sum(count.result() for count in counts)
        assert READ_S * MOST_A_SECOND / 4 < answers <= (READ_S + 1) * MOST_A_SECOND + WAITING
        assert value(read(address), "hexapod_frames_written_total", cause="watchdog") == 5


def answered(address: tuple[str, int], until_s: float) -> int:
    """How many of its requests got an answer, of which one byte is read."""
    count = 0
    while time.monotonic() < until_s:
        with suppress(OSError), socket.create_connection(address, 1) as connection:
            connection.sendall(b"GET /metrics HTTP/1.1\r\nHost: robot\r\n\r\n")
            count += bool(connection.recv(1))
    return count
