"""A program under test: its output, its signals and its end, each waited for as an event and with a bound."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from tests.support import zygote
from tests.support.runs import MARK
from tests.support.waiting import Closing


class Child(Closing):
    """A running program. Threads read what it prints, so it never stalls on a full pipe."""

    def __init__(self, command: Sequence[str], env: Mapping[str, str], cwd: Path | None = None) -> None:
        self.command = list(command)
        env = {MARK: os.environ.get(MARK, ""), **env}  # so that it ends with the run, whatever becomes of this process
        self._popen: zygote.Forked | subprocess.Popen[str]
        if zygote.fits(self.command, env):
            self._popen = zygote.Forked(self.command, env, cwd)
        else:
            self._popen = subprocess.Popen(
                self.command,
                env=env,
                cwd=cwd,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                bufsize=1,
            )
        self._heard = threading.Condition()
        self._stdout: list[str] = []
        self._stderr: list[str] = []
        self._readers = [
            threading.Thread(target=self._read, args=(pipe, lines), daemon=True)
            for pipe, lines in ((self._popen.stdout, self._stdout), (self._popen.stderr, self._stderr))
        ]
        self._open = len(self._readers)
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        return self._popen.pid

    @property
    def returncode(self) -> int | None:
        """Return the exit status, negative for a signal; None while it runs."""
        return self._popen.poll()

    @property
    def stdout(self) -> str:
        with self._heard:
            return "".join(self._stdout)

    @property
    def stderr(self) -> str:
        with self._heard:
            return "".join(self._stderr)

    def wait(self, timeout_s: float = 90.0) -> int:
        """Wait for its end and for all its output, and return the exit status. Raises TimeoutError."""
        try:
            status = self._popen.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"still running after {timeout_s} s: {self}") from None
        for reader in self._readers:
            reader.join(1.0)  # a grandchild may hold the pipes open for longer
        return status

    def wait_for_output(self, text: str, timeout_s: float = 90.0) -> str:
        """Wait until a line with `text` is printed, and return it. Raises TimeoutError, also at its end."""
        return self._wait(lambda lines: next((line for line in lines if text in line), None), f"{text!r}", timeout_s)

    def ask(self, line: str, timeout_s: float = 90.0) -> str:
        with self._heard:
            before = len(self._stdout)
        self.tell(line)
        return self.wait_for_line(before, timeout_s)

    def wait_for_line(self, index: int, timeout_s: float = 90.0) -> str:
        """Wait for that line of its output, counted from 0, and return it. Raises TimeoutError, also at its end."""
        return self._wait(
            lambda _lines: self._stdout[index] if len(self._stdout) > index else None, f"line {index}", timeout_s
        )

    def tell(self, line: str) -> None:
        assert self._popen.stdin is not None
        self._popen.stdin.write(line + "\n")
        self._popen.stdin.flush()

    def send_signal(self, number: signal.Signals) -> None:
        self._popen.send_signal(number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL, and wait for the end."""
        self.send_signal(signal.SIGKILL)
        self._popen.wait(5.0)

    def close(self) -> None:
        """Kill it if it runs. Processes that it has started may go on until the run of the tests ends."""
        if self.returncode is None:
            self.kill()
        for reader in self._readers:
            reader.join(1.0)
        assert self._popen.stdin is not None
        with suppress(BrokenPipeError):
            self._popen.stdin.close()

    def __str__(self) -> str:
        state = "running" if self.returncode is None else f"exit status {self.returncode}"
        return f"{' '.join(self.command)} ({state})\n--- stdout\n{self.stdout}--- stderr\n{self.stderr}"

    def _wait(self, find: Callable[[list[str]], str | None], what: str, timeout_s: float) -> str:
        deadline = time.monotonic() + timeout_s
        with self._heard:
            while (found := find(self._stdout + self._stderr)) is None:
                left_s = deadline - time.monotonic()
                if self._open == 0 or left_s <= 0 or not self._heard.wait(left_s):
                    why = "ended" if self._open == 0 else f"waited {timeout_s} s"
                    break
            else:
                return found
        raise TimeoutError(f"no {what} ({why}): {self}")

    def _read(self, pipe: IO[str] | None, lines: list[str]) -> None:
        assert pipe is not None
        with pipe:  # closed where it is read: close() waits for a read, which what this program has started may hold up
            for line in pipe:
                with self._heard:
                    lines.append(line)
                    self._heard.notify_all()
        with self._heard:
            self._open -= 1
            self._heard.notify_all()


@contextmanager
def frozen(*processes: int) -> Iterator[None]:
    """Stop each of these processes (SIGSTOP) while the `with` lasts."""
    for process in processes:
        os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        for process in processes:
            os.kill(process, signal.SIGCONT)
