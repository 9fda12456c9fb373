"""What the benchmarks know of other processes: how to start them on the emulated device, what they use and write."""

import json
import os
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from gateway.robot.protocol.latency import percentile
from tests.hil.bed import PROGRAM, SYSTEM_PYTHON
from tests.support.child import Child


def cpu_ns(pid: int) -> int:
    """The CPU time of all threads that live now, in nanoseconds; /proc/PID/stat knows only hundredths of a second."""
    total = 0
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):
            total += int((task / "schedstat").read_text().split()[0])
    return total


def never_delay(pid: int) -> None:
    """Give all present threads of a process real-time priority, if allowed: it stands for what is no program here."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(PermissionError, ProcessLookupError):  # the thread has ended
            os.sched_setscheduler(int(task.name), os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(50))


def rss_kb(pid: int, field: str = "VmRSS") -> int:
    """Resident memory now, or at most (VmHWM)."""
    return _status(pid, field)


def threads(pid: int) -> int:
    """Threads that live now."""
    return _status(pid, "Threads")


def fds(pid: int) -> int:
    """Open file descriptors."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def _status(pid: int, name: str) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


@dataclass(frozen=True, slots=True)
class Written:
    """One transfer as the emulated device saw it."""

    monotonic_ns: int
    data: bytes
    call: int = 0
    """The number of the ioctl that it was part of."""


class OnDevice:
    """A program on an emulated SPI device of its own, which writes what arrives to a file and costs us no time."""

    def __init__(self, command: list[str], log: Path, *, ready: str) -> None:
        self._log = log
        self.child = Child([SYSTEM_PYTHON, str(PROGRAM), "--log", str(log), "--", *command], os.environ)
        self.child.wait_for_output(ready, timeout_s=20)
        # The emulation is our child, and the program under test is its.
        own = self.child.pid
        self.pid = int(Path(f"/proc/{own}/task/{own}/children").read_text().split()[0])
        # The emulation stands for hardware, which no load slows; it is the same for whatever runs on it.
        never_delay(own)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.child.returncode is None:
            self.child.terminate()  # passed on; the emulation ends after the program and takes its files along
            with suppress(TimeoutError):
                self.child.wait(5)
        if self.child.returncode is None:
            # The naive script is still inside its callback, with a backlog of minutes.
            os.kill(self.pid, 9)
            self.child.wait(5)
        self.child.close()

    def written(self, since_ns: int = 0) -> list[Written]:
        """The transfers since then."""
        found = []
        for line in self._log.read_text().splitlines():
            with suppress(ValueError):  # the last line may be half written
                record = json.loads(line)
                if record["kind"] in ("write", "message") and record["t"] >= since_ns:
                    found.append(Written(record["t"], bytes.fromhex(record["data"]), record["call"]))
        return found


@dataclass(frozen=True, slots=True)
class Figures:
    """Percentiles of some latencies, in microseconds."""

    count: int
    p50_us: float
    p99_us: float
    max_us: float

    @classmethod
    def of(cls, latencies_ns: list[int]) -> Self:
        """Raises ValueError when there are none: a benchmark that saw nothing has no figure."""
        if not latencies_ns:
            raise ValueError("nothing arrived")
        ordered = [latency / 1000 for latency in sorted(latencies_ns)]
        return cls(len(ordered), percentile(ordered, 0.5), percentile(ordered, 0.99), ordered[-1])


def sixth_stop_us(written: list[Written], begun_ns: int) -> float | None:
    """From then until all six legs have been written a Stop since."""
    legs: set[int] = set()
    for transfer in written:
        if transfer.monotonic_ns >= begun_ns and len(transfer.data) == 14 and transfer.data[3] == 2:
            legs.add(transfer.data[2] // 10)
            if len(legs) == 6:
                return (transfer.monotonic_ns - begun_ns) / 1000
    return None


def now_ns() -> int:
    """The clock that all processes of this machine share."""
    return time.monotonic_ns()


def say(text: str) -> None:
    """One line of progress."""
    print(f"… {text}", file=sys.stderr, flush=True)
