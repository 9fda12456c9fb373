"""Small parts of the host: latencies, files, systemd, mounts, logs, settings in effect."""

import asyncio
import json
import logging
import os
import signal
import socket
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import islice
from pathlib import Path
from typing import IO, Any

import pytest

from gateway.host import effective
from gateway.host.directories import FORGETS, forgets, mount_of
from gateway.host.logs import MAX_LINES_WAITING, LogStream, LogWriter
from gateway.host.settings_reader import ForStops
from gateway.host.shared_page import Sensed, SensedPage, ServoPage
from gateway.model.frames import Framing
from gateway.robot.host.disk import DiskWriter
from gateway.robot.host.ownership import Ownership
from gateway.robot.host.systemd import PINGS_PER_TIMEOUT, SystemdNotifier
from gateway.robot.protocol.latency import Latency
from gateway.robot.service import SERVOS_FILE, ServosFile
from gateway.robot.settings import Settings


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


def test_a_latency_is_counted_once_though_two_threads_count() -> None:
    class ReadMeanwhile(deque[int]):
        """New latencies. While they are counted, another thread asks for shares."""

        def popleft(self) -> int:
            if asks := not asked:
                asked.append(asks)
                other = threading.Thread(target=latency.p50_p99_us)
                other.start()
                other.join()
            return super().popleft()

    asked: list[bool] = []
    latency = Latency(ReadMeanwhile())
    for each_us in (60, 150, 150):
        latency.record(each_us * 1000)
    assert (sum(latency.buckets), latency.sum_us, len(latency.recent_us), asked) == (3, 360.0, 3, [True])


# ---- The file that says on this machine whether a servo runs


def test_a_servos_file_of_an_earlier_run_is_replaced(tmp_path: Path) -> None:
    (tmp_path / SERVOS_FILE).write_text("something longer than the line, from another version\n")
    file = ServosFile(tmp_path)
    file.write(7, any_runs=True)
    assert (tmp_path / SERVOS_FILE).read_text() == f"{7:020d} 1\n"


def test_a_write_needs_no_room_in_a_folder_that_has_become_full(tmp_path: Path) -> None:
    """Without a block of its own, the write would end the gateway by SIGBUS."""
    ServosFile(tmp_path)
    assert (tmp_path / SERVOS_FILE).stat().st_blocks


def test_without_a_folder_there_is_no_servos_file(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    ServosFile(None).write(1, any_runs=True)
    with caplog.at_level(logging.WARNING):
        ServosFile(tmp_path / "none").write(1, any_runs=True)
    assert "an upgrade cannot see whether a servo runs" in caplog.text


# ---- The notifications to systemd, on the test's own socket


@contextmanager
def notifier(**environment: str) -> Iterator[SystemdNotifier]:
    """Yield a notifier in this environment. A service's socket closes with its process."""
    made = SystemdNotifier(environment)
    with nullcontext() if made._socket is None else made._socket:
        yield made


@pytest.mark.parametrize("begins", ["", "@"], ids=["a file", "an abstract name"])
def test_systemd_is_notified_and_delays_nothing_if_it_does_not_read(tmp_path: Path, begins: str) -> None:
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
def test_the_ping_period_follows_from_systemds_watchdog(
    path: str, timeout_us: str, pid: dict[str, str], period_s: float | None
) -> None:
    with notifier(NOTIFY_SOCKET=path, WATCHDOG_USEC=timeout_us, **pid) as made:
        assert made.ping_period_s == period_s
        if period_s is None:
            made.alive()
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0), "without systemd's watchdog nothing ends the process"


# ---- What is written to a disk is written aside, and the owner of the state learns of it


async def test_an_exception_on_the_disk_thread_is_reported() -> None:
    loop, learned = asyncio.get_running_loop(), asyncio.Future[str]()
    loop.set_exception_handler(lambda _, context: learned.set_result(context["message"]))
    disk = DiskWriter("disk", loop, Ownership())
    disk.write(lambda: [0].remove(1), lambda _: None)  # raises ValueError
    assert await learned == "the thread disk failed"
    again = asyncio.Event()
    disk.write(lambda: None, lambda _: loop.call_soon_threadsafe(again.set))
    await again.wait()


MOUNTS = """\
22 1 0:30 / / rw,relatime - overlay overlayroot rw,lowerdir=/media/root-ro,upperdir=/media/root-rw/overlay
23 22 179:3 / /var/lib/hexapod-gateway rw,noatime shared:2 - ext4 /dev/mmcblk0p3 rw
24 22 0:31 / /run rw,nosuid - tmpfs tmpfs rw
25 22 179:4 / /mnt/two\\040words rw - ext4 /dev/sda1 rw
26 22 179:4 / /srv rw - ext4 /dev/sda1 rw
27 26 0:33 / /srv rw - tmpfs tmpfs rw
"""


@pytest.mark.parametrize(
    ("folder", "mount", "kind"),
    [
        ("/var/lib", "/", "overlay"),
        ("/var/lib/hexapod-gateway/deeper", "/var/lib/hexapod-gateway", "ext4"),
        ("/var/lib/hexapod-gateway.old", "/", "overlay"),
        ("/run/user/0", "/run", "tmpfs"),
        ("/mnt/two words/state", "/mnt/two words", "ext4"),
        ("/srv/state", "/srv", "tmpfs"),
    ],
)
def test_the_mount_of_a_folder_is_found(folder: str, mount: str, kind: str) -> None:
    assert mount_of(Path(folder), MOUNTS) == (mount, kind)


def test_a_file_system_in_memory_counts_as_one_that_forgets() -> None:
    assert forgets(Path("/dev/shm")) == "tmpfs"  # noqa: S108 (the point of it)
    assert forgets(Path("/proc")) == ""
    assert "ext4" not in FORGETS


def test_the_root_of_a_chroot_need_not_be_a_mount_point() -> None:
    assert mount_of(Path("/var/lib"), "24 22 0:31 / /run rw,nosuid - tmpfs tmpfs rw") == ("/", "unknown")


def sensed(number: float) -> Sensed:
    """Return one whose 34 numbers all differ."""
    values = iter([number + place / 64 for place in range(34)])
    fields: Any = (tuple(islice(values, count)) for count in (4, 3, 3, 6, 18))
    return Sensed(*fields)


def test_another_process_reads_the_newest_sensor_values() -> None:
    writer = SensedPage()
    reader = SensedPage(writer.fd)
    assert reader.read() is None, "before the first"
    for number in (1.0, 2.0, 3.0):
        writer.write(sensed(number))
        assert reader.read() == sensed(number)


# ---- about simulated servos


def test_another_process_reads_the_servos_targets() -> None:
    writer = ServoPage()
    reader = ServoPage(writer.fd)
    writer.write(63, 12.25)
    writer.feed({11, 63})
    assert (reader.read()[63], reader.fed) == (12.25, frozenset((11, 63)))


class Pipe:
    """A pipe that is full until the test reads it."""

    def __init__(self, *, blocking: bool = True) -> None:
        ours, self.theirs = os.pipe()
        self.reader: IO[str] = os.fdopen(ours)
        os.set_blocking(self.theirs, False)
        with suppress(BlockingIOError):
            while True:
                os.write(self.theirs, b"." * 4095 + b"\n")
        os.set_blocking(self.theirs, blocking)

    def lines(self) -> Iterator[str]:
        """Return the lines written since it was full."""
        return (line.rstrip("\n") for line in self.reader if not line.startswith("."))

    def close(self) -> None:
        self.reader.close()
        os.close(self.theirs)


@pytest.fixture(params=[True, False], ids=["blocking", "non-blocking"])
def pipe(request: pytest.FixtureRequest) -> Iterator[Pipe]:
    pipe = Pipe(blocking=request.param)
    yield pipe
    pipe.close()


def test_log_lines_that_nobody_reads_in_time_are_dropped_and_counted(pipe: Pipe) -> None:
    log_writer = LogWriter(pipe.theirs)
    line = "x" * 1000
    for _ in range(2 * MAX_LINES_WAITING):
        log_writer.enqueue(f"{line}\n")
    dropped = log_writer.dropped
    assert MAX_LINES_WAITING - 2 <= dropped <= MAX_LINES_WAITING
    lines = pipe.lines()
    written = [next(lines) for _ in range(2 * MAX_LINES_WAITING - dropped + 1)]
    assert written.count(line) == len(written) - 1
    assert f"{dropped} lines were dropped here, since they were not read in time" in written
    log_writer.stop(10)


def test_a_line_that_cannot_be_rendered_or_written_is_counted() -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    log_writer = LogWriter(full)
    log_writer.handle(logging.makeLogRecord({"exc_info": "no exception"}))
    log_writer.enqueue("lost\n")
    log_writer.stop(10)
    os.close(full)
    assert log_writer.dropped == 2


def test_a_record_is_queued_though_a_thread_that_does_not_run_holds_the_handlers_lock() -> None:
    ours, theirs = os.pipe()
    log_writer = LogWriter(theirs)
    caller = threading.Thread(target=log_writer.handle, args=(logging.makeLogRecord({"msg": "queued"}),), daemon=True)
    log_writer.acquire()
    caller.start()
    caller.join(5)
    assert not caller.is_alive()
    log_writer.release()
    log_writer.stop(10)
    os.close(theirs)
    with os.fdopen(ours) as reader:
        assert reader.read() == "queued\n"


def test_printed_text_goes_through_the_log_writer(pipe: Pipe) -> None:
    log_writer = LogWriter(pipe.theirs)
    stream = LogStream(log_writer)
    lines = pipe.lines()
    print("a", "result", file=stream)
    stream.write("two\nlines and a part")
    assert [next(lines) for _ in range(2)] == ["a result", "two"]
    print(flush=True, file=stream)
    assert next(lines) == "lines and a part"
    log_writer.stop(10)


USED = Settings.of(
    {
        "spi": {"framing": "length-prefixed", "device": '/dev/spi"dev1.0', "speed_hz": 500_000, "frame_gap_us": 60.5},
        "controller": {"uart": "/dev/ttyS0"},
        "power": {"interface": "slcan", "channel": "/dev/ttyACM0"},
    }
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the service's runtime directory."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    monkeypatch.delenv("INVOCATION_ID", raising=False)
    return tmp_path


def test_without_a_runtime_directory_nothing_is_written(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    effective.write(ForStops(USED.wire, USED.spi, USED.controller, USED.power))
    assert list(folder.iterdir()) == []


def test_settings_of_an_ended_process_are_not_in_effect(folder: Path) -> None:
    """A number alone shows nothing: the kernel gives it again."""
    effective.write(ForStops(USED.wire, USED.spi, USED.controller, USED.power))
    written = json.loads((folder / effective.NAME).read_text())
    beyond = 2**22 + 1  # which the kernel gives to none
    for others in ({"process": beyond}, {"begun": 1}):
        (folder / effective.NAME).write_text(json.dumps(written | others))
        found = effective.read()
        assert found is not None
        assert not found.runs
        assert effective.running() is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff",
        b"[]",
        b"[" * 5000,
        b'{"spi": 3}',
        b'{"spi": {"framing": "Plain"}}',
        b'{"spi": {"speed_hz": 1000}}',
        b'{"spi": {"framing": "plain", "speed_hz": 0}}',
    ],
)
def test_a_damaged_file_of_settings_in_effect_is_ignored(folder: Path, content: bytes) -> None:
    assert effective.read() is None
    (folder / effective.NAME).write_bytes(content)
    assert effective.read() is None


def test_differences_between_a_file_and_the_settings_in_effect_are_named(folder: Path) -> None:
    effective.write(ForStops(USED.wire, USED.spi, USED.controller, USED.power))
    found = effective.read()
    assert found is not None
    file = folder / "gateway.toml"
    rest = 'device = "/dev/spi\\"dev1.0"\nspeed_hz = 500_000\nframe_gap_us = 60.5\n'
    uart = "[controller]\nuart = '/dev/ttyS0'\n"
    uart += "[power]\ninterface = 'slcan'\nchannel = '/dev/ttyACM0'\n"
    file.write_text(f'[spi]\nframing = "length-prefixed"\n{rest}{uart}')
    assert effective.differences(found, file) == []
    assert found == effective.running()
    file.write_text(f'[spi]\nframing = "plain"\nspeed_hz = 500_000\n{uart}')
    assert effective.differences(found, file) == [
        f'{file} has spi.framing = "plain", and the service uses "length-prefixed"',
        f'{file} has spi.device = "/dev/spidev0.0", and the service uses "/dev/spi\\"dev1.0"',
        f"{file} has spi.frame_gap_us = 50.0, and the service uses 60.5",
    ]
    for text in ("spi = 3\n", "no TOML"):
        file.write_text(text)
        assert Framing.LENGTH_PREFIXED in effective.differences(found, file)[0]
    os.mkfifo(folder / "FIFO")
    for name in ("none", "FIFO"):
        assert "cannot be read" in effective.differences(found, folder / name)[0]
