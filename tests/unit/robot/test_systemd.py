"""The notifications to systemd, on the test's own socket."""

import os
import socket
from pathlib import Path

import pytest

from gateway.robot.host.systemd import PINGS_PER_TIMEOUT, SystemdNotifier


@pytest.fixture
def listener(tmp_path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(tmp_path / "notify"))
    listener.settimeout(5)
    return listener


def test_what_is_told(listener: socket.socket) -> None:
    with listener:
        notifier = SystemdNotifier({"NOTIFY_SOCKET": listener.getsockname()})
        notifier.ready("takes commands")
        notifier.alive()
        notifier.stopping()
        notifier.close()
        assert [listener.recv(100) for _ in range(3)] == [
            b"READY=1\nSTATUS=takes commands",
            b"WATCHDOG=1",
            b"STOPPING=1",
        ]


def test_a_manager_that_does_not_read_holds_nobody_up(listener: socket.socket) -> None:
    with listener:
        notifier = SystemdNotifier({"NOTIFY_SOCKET": listener.getsockname()})
        for _ in range(10_000):
            notifier.alive()
        notifier.close()


def test_without_a_manager_nothing_happens() -> None:
    notifier = SystemdNotifier({})
    notifier.ready("x")
    notifier.alive()
    assert notifier.ping_period_s is None


@pytest.mark.parametrize(
    ("environment", "period_s"),
    [
        ({"WATCHDOG_USEC": "2000000"}, 2 / PINGS_PER_TIMEOUT),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}, 2 / PINGS_PER_TIMEOUT),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_how_often_it_wants_to_hear(environment: dict[str, str], period_s: float | None) -> None:
    notifier = SystemdNotifier({"NOTIFY_SOCKET": "/nowhere", **environment})
    assert notifier.ping_period_s == period_s
    notifier.close()
