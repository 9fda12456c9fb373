"""The service's logging, as lines of text. Callers never block.

A background thread writes, since a reader of stdout or stderr may stop reading (a full pipe, a paused terminal, a stuck
journal); on the loop, this would delay every Stop.

It uses the standard library. structlog loads rich; with both, loading the service's modules took 470 ms of processor
time, without them 290, and a restarted service writes its first Stops that much earlier.
"""

import atexit
import faulthandler
import io
import logging
import os
import select
import shlex
import signal
import sys
import threading
import time
from datetime import UTC, datetime
from functools import partial
from typing import Final

from gateway.host.directories import runtime_directory
from gateway.host.worker import Worker
from gateway.words.text import visible

MAX_LINES_WAITING: Final = 1000
"""About 1 MB. Above this, lines are dropped."""


class LogWriter(logging.Handler):
    """Writes records and texts to `descriptor` by a thread of its own. Queuing them never blocks.

    With concurrent callers the queue may exceed `MAX_LINES_WAITING` by a few lines.
    """

    def __init__(self, descriptor: int, formatter: logging.Formatter | None = None) -> None:
        super().__init__()
        self.descriptor = descriptor
        self.setFormatter(formatter)
        self.dropped = 0
        """Lines not written, because the queue was full or writing failed."""
        self._dropped_logged = 0
        self._worker = Worker("log")

    def handle(self, record: logging.LogRecord) -> bool:
        """Queue a record, without the handler's lock, which a descheduled thread may hold.

        Format the message now, since its arguments may change. The thread formats exceptions, which needs files.
        """
        try:
            record.msg, record.args = record.getMessage(), None
            self.enqueue(record)
        except Exception:  # the arguments do not fit the message
            self.handleError(record)
        return True

    def enqueue(self, record: logging.LogRecord | str) -> None:
        """Queue a record, or a text that is written unchanged. Drop it if too many wait."""
        if self._worker.waiting < MAX_LINES_WAITING:
            self._worker.do(partial(self._write, record))
        else:
            self.dropped += 1

    def stop(self, timeout_s: float) -> None:
        """Write the queued lines and end the thread. Give up after `timeout_s`."""
        self._worker.close(timeout_s)

    def _write(self, record: logging.LogRecord | str) -> None:
        """Write on the thread. It holds no handler's lock, since `logging.shutdown` takes these."""
        try:
            self._write_all(record)
            missing = self.dropped - self._dropped_logged
            if missing and self._worker.waiting <= MAX_LINES_WAITING // 2:
                self._dropped_logged += missing
                why = f"{missing} lines were dropped here, since they were not read in time"
                self._write_all(logging.LogRecord(__name__, logging.WARNING, __file__, 0, why, None, None))
        except Exception:  # a full disk, a reader that ended, a line that cannot be rendered: skip the line
            self.dropped += 1

    def _write_all(self, record: logging.LogRecord | str) -> None:
        text = record if isinstance(record, str) else f"{self.format(record)}\n"
        data = text.encode(errors="backslashreplace")
        # Unbuffered: if a blocked thread held a buffer's lock, the interpreter would abort at its end.
        while data:
            try:
                data = data[os.write(self.descriptor, data) :]
            except BlockingIOError:  # another program has made the shared terminal non-blocking
                select.select([], [self.descriptor], [])


class _Line(threading.local):
    text = ""


class LogStream(io.TextIOBase):
    """Replaces `sys.stdout` or `sys.stderr`, for results, output of libraries, and tracebacks of threads."""

    def __init__(self, log_writer: LogWriter) -> None:
        self._log_writer = log_writer
        self._unfinished = _Line()

    def write(self, text: str) -> int:
        lines, end, rest = (self._unfinished.text + text).rpartition("\n")
        self._unfinished.text = rest
        if end:
            self._log_writer.enqueue(lines + end)
        return len(text)

    def flush(self) -> None:
        """Queue the unfinished line. Never waits."""
        rest, self._unfinished.text = self._unfinished.text, ""
        if rest:
            self._log_writer.enqueue(rest)

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._log_writer.descriptor


FLUSH_S: Final = 0.3
"""How long the end waits for unwritten lines; it may take a second (docs/interface.md, Behaviour *End*)."""

_log_writers: list[LogWriter] = []


def set_up() -> None:
    """Log to stderr from INFO on, in Python's development mode (`python -X dev`) from DEBUG on.

    Two background threads write to stdout and stderr from now on.
    """
    out, err = LogWriter(1), LogWriter(2, _Lines(2))
    _log_writers[:] = [out, err]
    sys.stdout, sys.stderr = LogStream(out), LogStream(err)
    atexit.register(close)
    root = logging.getLogger()
    root.handlers[:] = [err]
    root.setLevel(logging.DEBUG if sys.flags.dev_mode else logging.INFO)


def close(timeout_s: float = FLUSH_S) -> None:
    """Write the queued lines. Give up after `timeout_s`."""
    end = time.monotonic() + timeout_s
    for log_writer in reversed(_log_writers):
        log_writer.stop(max(0.0, end - time.monotonic()))
    _log_writers.clear()


def dropped() -> int:
    """Return how many lines were not written because stdout or stderr was not read in time."""
    return sum(log_writer.dropped for log_writer in _log_writers)


def keep_stacks() -> None:
    """Under systemd, write the stacks of all threads to a file after a crash or a hang. The unit logs the file later.

    The file is in memory, so writing never blocks. With a stuck stderr, the signal handler would block, the process
    would not end, and `stop-servos` would not run.
    """
    folder = runtime_directory()
    if folder is not None:
        try:
            stacks = (folder / "stacks").open("w")
            faulthandler.enable(stacks)
            faulthandler.register(signal.SIGALRM, stacks, chain=True)  # see SystemdNotifier; `chain` ends the process
        except OSError as error:
            logging.getLogger(__name__).warning("the stacks of a hang cannot be kept: %s", error)


class _Lines(logging.Formatter):
    """Text, escaped: a client's text can neither control the terminal nor fake log lines.

    In the journal, which adds the time, each line follows its syslog priority, for `journalctl -p warning`.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        found = os.fstat(descriptor)
        self._journal = os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"  # systemd.exec(5)

    def format(self, record: logging.LogRecord) -> str:
        priority = f"<{_PRIORITIES[max(level for level in _PRIORITIES if level <= record.levelno)]}>"
        # The time of the call; the line may be written much later.
        made = datetime.fromtimestamp(record.created, UTC).isoformat().replace("+00:00", "Z")
        found = sorted((name, value) for name, value in vars(record).items() if name not in _OF_EACH_RECORD)
        fields = "".join(f" {name}={shlex.quote(str(value))}" for name, value in found if value is not None)
        head = "" if self._journal else f"{made} [{record.levelname.lower():8}] "
        fault = self.formatException(record.exc_info).splitlines() if record.exc_info else []
        lines = [f"{head}{visible(record.getMessage() + fields)}", *map(visible, fault)]
        return "\n".join(f"{priority if self._journal else ''}{line}" for line in lines)


_PRIORITIES: Final = {logging.NOTSET: 7, logging.INFO: 6, logging.WARNING: 4, logging.ERROR: 3, logging.CRITICAL: 2}
_OF_EACH_RECORD: Final = {*vars(logging.makeLogRecord({})), "taskName"}
