"""Small parts of the host: latencies, files, systemd, a writer to disk; how many bytecodes a message takes."""

import asyncio
import logging
import os
import signal
import socket
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from gateway.robot.host.disk import DiskWriter
from gateway.robot.host.ownership import Ownership
from gateway.robot.host.systemd import PINGS_PER_TIMEOUT, SystemdNotifier
from gateway.robot.protocol.latency import Latency
from gateway.robot.service import SERVOS_FILE, ServosFile
from schemas import keys
from tests.support.robot import leg, started_and_quiet


@pytest.mark.parametrize(
    ("latencies_us", "p50", "p99", "of_the_last"),
    [
        ([], None, None, (None, None)),
        ([30] * 99 + [4_000], 50, 50, (30, 30)),
        ([30] * 98 + [4_000] * 2, 50, 4_000, (30, 4_000)),
        ([60, 150, 150, 150], 150, 150, (150, 150)),
        ([900_000, 60], 100, 900_000, (60, 900_000)),
    ],
)
def test_a_share_is_at_most_its_buckets_end_or_the_worst(
    latencies_us: list[int], p50: float | None, p99: float | None, of_the_last: tuple[float | None, float | None]
) -> None:
    latency = Latency()
    for each_us in latencies_us:
        latency.record(each_us * 1000)
    assert (latency.at_most_us(0.5), latency.at_most_us(0.99), latency.p50_p99_us()) == (p50, p99, of_the_last)


# ---- The file that says on this machine whether a servo runs


def test_what_an_earlier_run_has_left_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / SERVOS_FILE).write_text("something longer than the line, from another version\n")
    file = ServosFile(tmp_path)
    file.write(7, any_runs=True)
    assert (tmp_path / SERVOS_FILE).read_text() == f"{7:020d} 1\n"


def test_a_write_needs_no_room_in_a_folder_that_has_become_full(tmp_path: Path) -> None:
    """Without a block, it would end the gateway by SIGBUS."""
    ServosFile(tmp_path)
    assert (tmp_path / SERVOS_FILE).stat().st_blocks


def test_without_a_folder_it_is_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ServosFile(None).write(1, any_runs=True)
    with caplog.at_level(logging.WARNING):
        ServosFile(tmp_path / "none").write(1, any_runs=True)
    assert "an upgrade cannot see whether a servo runs" in caplog.text


# ---- The notifications to systemd, on the test's own socket


@contextmanager
def notifier(**environment: str) -> Iterator[SystemdNotifier]:
    """A notifier in this environment. A service's socket closes with its process."""
    made = SystemdNotifier(environment)
    with nullcontext() if made._socket is None else made._socket:
        yield made


@pytest.mark.parametrize("begins", ["", "@"], ids=["a file", "an abstract name"])
def test_what_is_told_and_a_manager_that_does_not_read_holds_nobody_up(tmp_path: Path, begins: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        path = begins + str(tmp_path / "notify")
        listener.bind(path.replace("@", "\0"))
        listener.settimeout(5)
        with notifier(NOTIFY_SOCKET=path) as made:
            made.ready("takes commands")
            made.stopping()
            for _ in range(10_000):
                made.alive()
        told = [listener.recv(100) for _ in range(3)]
    assert told == [b"READY=1\nSTATUS=takes commands", b"STOPPING=1", b"WATCHDOG=1"]


@pytest.mark.parametrize(
    ("path", "timeout_us", "pid", "period_s"),
    [
        ("/nowhere", "2000000", {}, 2 / PINGS_PER_TIMEOUT),
        ("/nowhere", "2000000", {"WATCHDOG_PID": str(os.getpid())}, 2 / PINGS_PER_TIMEOUT),
        ("/nowhere", "2000000", {"WATCHDOG_PID": str(os.getppid())}, None),
        ("/nowhere", "0", {}, None),
        ("", "2000000", {}, None),
    ],
)
def test_how_often_it_wants_to_hear(path: str, timeout_us: str, pid: dict[str, str], period_s: float | None) -> None:
    with notifier(NOTIFY_SOCKET=path, WATCHDOG_USEC=timeout_us, **pid) as made:
        assert made.ping_period_s == period_s
        if period_s is None:
            made.alive()
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0), "without systemd's watchdog nothing ends the process"


# ---- What is written to a disk is written aside, and the owner of the state learns of it


async def test_a_mistake_of_our_own_ends_the_service() -> None:
    loop, learned = asyncio.get_running_loop(), asyncio.Future[str]()
    loop.set_exception_handler(lambda _, context: learned.set_result(context["message"]))
    disk = DiskWriter("disk", loop, Ownership())
    disk.write(lambda: [0].remove(1), lambda _: None)  # raises ValueError
    assert await learned == "the thread disk failed"
    again = asyncio.Event()
    disk.write(lambda: None, lambda _: loop.call_soon_threadsafe(again.set))
    await again.wait()


# ---- How many bytecodes a message takes: what is added shows here (docs/design.md, *How fast*)


_ALL = {"legs": {str(number): leg("start", 90, 45, 120) for number in range(1, 7)}}


def bytecodes(do: Callable[[], object]) -> tuple[int, int]:
    """Return how many bytecodes of the gateway's own functions a call executes, and how many distinct ones.

    The distinct ones predict the cost: other programs push the gateway out of the processor's caches.
    """
    executed: Counter[tuple[CodeType, int]] = Counter()

    def trace(frame: FrameType, event: str, _arg: object) -> Any:
        path = frame.f_code.co_filename
        if not any(folder in path for folder in ("/gateway/robot/", "/gateway/model/", "/schemas/")):
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        if event == "opcode":
            executed[frame.f_code, frame.f_lasti] += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        do()
    finally:
        sys.settrace(before)
    return executed.total(), len(executed)


@pytest.mark.virtual_time
@pytest.mark.parametrize(
    ("key", "payload", "most", "most_distinct"),
    [
        pytest.param(keys.ESTOP, {}, 10800, 3520, id="an emergency stop while all legs run"),
        pytest.param(keys.leg_command(3), leg("set", 91, 45, 120), 1745, 1440, id="a leg's setpoint"),
        pytest.param(keys.LEGS_COMMAND, _ALL, 4850, 1420, id="a setpoint of all legs"),
    ],
)
async def test_a_tick_of_a_stream_has_so_few_bytecodes(
    key: str, payload: object, most: int, most_distinct: int
) -> None:
    """The stream is older than 0.8 s, when legs at rest would be due. Later Pythons count differently."""
    robot = await started_and_quiet()
    robot.put(keys.LEGS_COMMAND, _ALL)
    for _ in range(60):
        await asyncio.sleep(0.02)
        robot.put(keys.LEGS_COMMAND, _ALL)
    await asyncio.sleep(0.02)
    executed, distinct = bytecodes(lambda: robot.put(key, payload))
    more = 1.0 if sys.version_info < (3, 12) else 1.3
    assert executed <= most * more
    assert distinct <= most_distinct * more
