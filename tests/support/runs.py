"""A run of the tests: its failed tests, a line each; and the processes it has started, found by a mark, and ended."""

import os
import secrets
import select
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import TYPE_CHECKING, Final

from tests.support.waiting import Closing

if TYPE_CHECKING:  # a robot on which scenes run has none
    import pytest

ENDS_WITH_US: Final = (
    *("setpriv", "--pdeathsig", "KILL"),
    *("unshare", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"),
)
"""A prefix with which a command's processes end with it, and it with this process. Needs root."""
LIST: Final = "TESTS_FAILED"
"""The environment variable that names the list, for the stages."""
_WIDTH, _MOST = 200, 20


@contextmanager
def listed() -> Iterator[None]:
    """Collect what fails in the stages that begin within, and print it at the end."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "failed"
        path.touch()
        os.environ[LIST] = str(path)
        try:
            yield
        finally:
            for line in path.read_text(encoding="utf-8").splitlines()[:_MOST]:
                print(line)


def add(report: "pytest.TestReport") -> None:
    """Add a failed test to the run's list, if there is one; a worker's reports come to its controller, too."""
    path = os.environ.get(LIST)
    if report.failed and path and "PYTEST_XDIST_WORKER" not in os.environ:
        crash = getattr(report.longrepr, "reprcrash", None)
        why = (crash.message if crash else str(report.longrepr)).strip().partition("\n")[0]
        with Path(path).open("a", encoding="utf-8") as lines:
            lines.write(f"failed in {report.when}: {report.nodeid}: {why}"[:_WIDTH] + "\n")


MARK: Final = "TESTS_RUN"
PATIENCE_S: Final = {signal.SIGTERM: 10.0, signal.SIGKILL: 5.0}
"""How long each signal has to work. After the first, a browser writes its profile, a box removes its mounts."""
LOOK_S: Final = 0.5
"""How often processes are looked for if none ends: one that ends may start another."""


class Run(Closing):
    """All processes that this one starts from now on, and theirs; `close` ends those that are left."""

    def __init__(self) -> None:
        self.mark = f"{os.environ.get(MARK, '')}/{os.getpid()}-{secrets.token_hex(4)}"
        os.environ[MARK] = self.mark

    def processes(self) -> set[int]:
        """Return the running processes that have the mark, or were started by one of them."""
        parents = dict(_parents())
        found = {pid for pid in parents if self._has_mark(pid)}
        while more := {pid for pid, parent in parents.items() if parent in found} - found:
            found |= more
        return found

    def close(self) -> None:
        for number, patience_s in PATIENCE_S.items():
            until_s = time.monotonic() + patience_s
            asked: set[int] = set()
            while (left := self.processes()) and time.monotonic() < until_s:
                for pid in left - asked:
                    send(pid, number)
                    send(pid, signal.SIGCONT)  # a test may have stopped it
                asked |= left
                _wait_for_one_of(left)

    def pass_on(self) -> None:
        """Have a signal that would end this process end its children, in order; without any, this process."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._pass_on)

    def _pass_on(self, number: int, _frame: FrameType | None) -> None:
        ended = children(os.getpid())
        for pid in ended:
            send(pid, signal.SIGTERM)
        if not ended:
            raise SystemExit(128 + number)

    def _has_mark(self, pid: int) -> bool:
        with suppress(OSError):  # it has ended, or is of another user
            marks = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
            mine = f"{MARK}={self.mark}".encode()
            return any(each == mine or each.startswith(mine + b"/") for each in marks)
        return False


def children(process: int) -> list[int]:
    return [pid for pid, parent in _parents() if parent == process]


def _parents() -> Iterator[tuple[int, int]]:
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            state, parent = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
            if state not in "ZX":
                yield int(folder.name), int(parent)


def send(pid: int, number: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.kill(pid, number)


def _wait_for_one_of(processes: set[int]) -> None:
    """Wait until one of them ends, `LOOK_S` at the most."""
    poll, opened = select.poll(), []
    for pid in processes:
        with suppress(ProcessLookupError):
            opened.append(os.pidfd_open(pid))
            poll.register(opened[-1], select.POLLIN)
    if len(opened) == len(processes):
        poll.poll(LOOK_S * 1000)
    for each in opened:
        os.close(each)
