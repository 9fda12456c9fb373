"""What benchmarks and tests ask of other processes: what they use of the machine."""

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.support.child import Child


def program(name: str, *arguments: str, prefix: Sequence[str] = ()) -> Child:
    """Return another program of the benchmarks in a process of its own; `prefix` goes before its command."""
    return Child([*prefix, sys.executable, "-m", f"tests.benchmarks.{name}", *arguments], os.environ)


@contextmanager
def publishing(endpoint: str, *options: str) -> Iterator[Child]:
    """Yield a publisher that has begun, and goes on to the end."""
    with program("publisher", endpoint, *options) as publisher:
        publisher.wait_for_output("ready")
        publisher.tell(str(1e6))
        yield publisher


@contextmanager
def flooding(endpoint: str, key: str, payload: str, *options: str, prefix: Sequence[str] = ()) -> Iterator[None]:
    """Return a program that publishes this as fast as it can; with `--ask` it asks instead of publishing."""
    with program("publisher", endpoint, "--flood", key, payload, *options, prefix=prefix) as flood:
        flood.wait_for_output("flooding")
        yield


def cpu_ns(pid: int) -> int:
    """Return the CPU time of all living threads, in nanoseconds: /proc/PID/stat has only hundredths of a second."""
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
    """Return resident memory in kB, now or at most (VmHWM)."""
    return _status(pid, field)


def threads(pid: int) -> int:
    return _status(pid, "Threads")


def fds(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))


def _status(pid: int, name: str) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


def say(text: str) -> None:
    print(f"… {text}", file=sys.stderr, flush=True)
