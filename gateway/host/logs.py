"""The service's logging: text on a terminal and in the journal, else JSON lines. Callers never block.

A background thread writes: the reader of stdout or stderr may stop reading (a full pipe, a paused terminal, a stuck
journal), and on the loop a write that waits for it would delay every Stop.

By the standard library: structlog loads rich, and with them the service's modules took 470 ms of processor time to
load, without them 290. A service that starts anew writes its first Stops that much earlier.
"""

import atexit
import faulthandler
import io
import logging
import os
import re
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import Final

from gateway.host.directories import runtime_directory
from gateway.host.worker import Worker
from gateway.text import visible, visible_json

MAX_LINES_WAITING: Final = 1000
"""Some 1 MB. Above it, lines are dropped until half of the queue is written."""


class LogWriter:
    """One descriptor, and the thread that writes to it.

    `put` never blocks. With concurrent callers the queue may exceed `MAX_LINES_WAITING` by a few lines.
    """

    def __init__(
        self,
        descriptor: int,
        render: Callable[[logging.LogRecord], str] = logging.LogRecord.getMessage,
    ) -> None:
        self.descriptor = descriptor
        self.dropped = 0
        """Lines that were not written: the queue was full, or writing failed."""
        self._render = render
        self._dropped_logged = 0
        self._full = False
        self._worker = Worker(f"log_writer-{descriptor}")

    def put(self, item: logging.LogRecord | str) -> None:
        """Queue a record, written as one line, or a text, written unchanged."""
        waiting = self._worker.waiting
        if waiting >= MAX_LINES_WAITING or (self._full and waiting > MAX_LINES_WAITING // 2):
            self._full = True
            self.dropped += 1
            return
        self._full = False
        self._worker.do(partial(self._write, item))

    def close(self, timeout_s: float) -> None:
        """Write the queued lines and end the thread; gives up after `timeout_s`."""
        self._worker.close(timeout_s)

    # ---- on the thread

    def _write(self, item: logging.LogRecord | str) -> None:
        written = self._write_item(item)
        dropped = self.dropped
        if written and dropped != self._dropped_logged and self._worker.waiting <= MAX_LINES_WAITING // 2:
            self._write_item(_left_out(dropped - self._dropped_logged))
            self._dropped_logged = dropped

    def _write_item(self, item: logging.LogRecord | str) -> bool:
        try:
            text = item if isinstance(item, str) else f"{self._render(item)}\n"
            self._write_bytes(text.encode(errors="backslashreplace"))
        except Exception:  # a full disk, a reader that ended, a line that cannot be rendered: continue with the next
            self.dropped += 1
            return False
        return True

    def _write_bytes(self, data: bytes) -> None:
        # Unbuffered: if a blocked thread held a buffer's lock, the interpreter would abort at its end.
        while data:
            try:
                data = data[os.write(self.descriptor, data) :]
            except BlockingIOError:  # another program has made the shared terminal non-blocking
                select.select([], [self.descriptor], [])


def _left_out(lines: int) -> logging.LogRecord:
    detail = f"{lines} lines were dropped here, since they were not read in time"
    return logging.LogRecord(__name__, logging.WARNING, __file__, 0, detail, None, None)


class _Line(threading.local):
    text = ""


class LogStream(io.TextIOBase):
    """Replaces `sys.stdout` or `sys.stderr`, for results, what libraries print, and tracebacks of threads."""

    def __init__(self, log_writer: LogWriter) -> None:
        self._log_writer = log_writer
        self._unfinished = _Line()

    def write(self, text: str) -> int:
        lines, end, rest = (self._unfinished.text + text).rpartition("\n")
        self._unfinished.text = rest
        if end:
            self._log_writer.put(lines + end)
        return len(text)

    def flush(self) -> None:
        """Queue the unfinished line. Never waits."""
        rest, self._unfinished.text = self._unfinished.text, ""
        if rest:
            self._log_writer.put(rest)

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._log_writer.descriptor

    def isatty(self) -> bool:
        return os.isatty(self._log_writer.descriptor)


FLUSH_S: Final = 0.3
"""How long the end waits for unwritten lines, of the second that it may take (docs/interface.md, Behaviour *End*)."""

_log_writers: list[LogWriter] = []


def set_up() -> None:
    """Log to stderr from INFO on; from DEBUG on in Python's development mode (`python -X dev`).

    From now on two background threads write to stdout and stderr.
    """
    journal = _is_journal(2)
    render = _formatter(terminal=os.isatty(2), journal=journal).format
    out, err = LogWriter(1), LogWriter(2, _with_priority(render) if journal else render)
    _log_writers[:] = [out, err]
    sys.stdout, sys.stderr = LogStream(out), LogStream(err)
    atexit.register(close)
    root = logging.getLogger()
    root.handlers[:] = [_Handler(err)]
    root.setLevel(logging.DEBUG if sys.flags.dev_mode else logging.INFO)


def _is_journal(descriptor: int) -> bool:
    """Whether the descriptor is the journal, by JOURNAL_STREAM (systemd.exec(5))."""
    found = os.fstat(descriptor)
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


def _with_priority(render: Callable[[logging.LogRecord], str]) -> Callable[[logging.LogRecord], str]:
    """Prefix each line with its syslog priority, for `journalctl -p warning`; the journal removes it."""

    def rendered(record: logging.LogRecord) -> str:
        levels = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
        priority = next((number for level, number in levels if record.levelno >= level), 7)
        return "\n".join(f"<{priority}>{line}" for line in render(record).split("\n"))

    return rendered


def close(timeout_s: float = FLUSH_S) -> None:
    """Write the queued lines; gives up after `timeout_s`."""
    end = time.monotonic() + timeout_s
    for log_writer in reversed(_log_writers):
        log_writer.close(max(0.0, end - time.monotonic()))
    _log_writers.clear()


def dropped() -> int:
    """Lines that were not written, because stdout or stderr was not read in time."""
    return sum(log_writer.dropped for log_writer in _log_writers)


def keep_stacks() -> None:
    """Under systemd, write the stacks of all threads to a file after a crash or a hang.

    Not to stderr: the signal handler writes directly, and with a stuck stderr the process would not die, and
    `stop-servos` would not run. The file is in memory, so writing never blocks. The unit logs it afterwards.
    """
    folder = runtime_directory()
    if folder is not None:
        try:
            stacks = (folder / "stacks").open("w")
            faulthandler.enable(stacks)
            faulthandler.register(signal.SIGALRM, stacks, chain=True)  # see SystemdNotifier; `chain`: then it ends
        except OSError as error:
            logging.getLogger(__name__).warning("the stacks of a hang cannot be kept: %s", error)


class _Handler(logging.Handler):
    """Puts records into the LogWriter's queue.

    `logging.handlers.QueueHandler` would render exceptions here, which reads files, and take a lock, which a
    descheduled thread may hold.
    """

    def __init__(self, log_writer: LogWriter) -> None:
        super().__init__()
        self._log_writer = log_writer

    def handle(self, record: logging.LogRecord) -> bool:
        """Formats the message at once, since its arguments may change later."""
        try:
            record.msg, record.args = record.getMessage(), None
        except Exception:
            self.handleError(record)
        else:
            self._log_writer.put(record)
        return True


def _formatter(*, terminal: bool, journal: bool) -> logging.Formatter:
    if journal:
        return _LinesForJournal(colours=False)
    return _LinesForPeople(colours=True) if terminal else _JsonLines()


class _JsonLines(logging.Formatter):
    """One JSON line per record, of printable characters only."""

    def format(self, record: logging.LogRecord) -> str:
        line: dict[str, object] = {
            "level": record.levelname.lower(),
            "logger": record.name,
            **_fields(record),
            "timestamp": _time(record),
            "message": record.getMessage(),
        }
        if record.exc_info is not None:
            line["exception"] = _exceptions(record.exc_info[1])
        return visible_json(line)


class _LinesForPeople(logging.Formatter):
    """Text for a terminal. Escaped, so that a sender's text can neither control the terminal nor fake log lines."""

    def __init__(self, *, colours: bool) -> None:
        super().__init__()
        self._colours = colours

    def format(self, record: logging.LogRecord) -> str:
        parts = self._head(record)
        for name, value in sorted(_fields(record).items()):
            text = repr(value) if isinstance(value, str) and not _BARE.fullmatch(value) else visible(str(value))
            parts.append(f"{self._paint(_CYAN, name)}={self._paint(_MAGENTA, text)}")
        fault = "" if record.exc_info is None else self.formatException(record.exc_info)
        return "\n".join([" ".join(parts), *map(visible, fault.splitlines())])

    def _head(self, record: logging.LogRecord) -> list[str]:
        level = self._paint(_COLOURS.get(record.levelno, _RED), f"{record.levelname.lower():9}")
        message = self._paint(_BOLD, f"{visible(record.getMessage()):30}")
        return [self._paint(_DIM, _time(record)), f"[{level}]", message, f"[{self._paint(_BLUE, record.name)}]"]

    def _paint(self, colour: str, text: str) -> str:
        return f"\x1b[{colour}m{text}\x1b[0m" if self._colours else text


class _LinesForJournal(_LinesForPeople):
    """The message first; the journal adds time and priority."""

    def _head(self, record: logging.LogRecord) -> list[str]:
        return [visible(record.getMessage())]


_BOLD, _DIM, _RED, _BLUE, _CYAN, _MAGENTA = "1", "2", "31;1", "34;1", "36", "35"
_COLOURS: Final = {logging.DEBUG: "32;1", logging.INFO: "32;1", logging.WARNING: "33;1"}
_BARE: Final = re.compile(r"[\w./:@+-]+")
"""A value without quotes."""
_MOST_CAUSES: Final = 10
_OF_EACH_RECORD: Final = {*vars(logging.makeLogRecord({})), "taskName"}


def _fields(record: logging.LogRecord) -> dict[str, object]:
    """The `extra` values of a log call that are not None."""
    return {name: value for name, value in vars(record).items() if name not in _OF_EACH_RECORD and value is not None}


def _time(record: logging.LogRecord) -> str:
    """Time of the log call; the line may be written much later."""
    return datetime.fromtimestamp(record.created, UTC).isoformat().replace("+00:00", "Z")


def _exceptions(error: BaseException | None) -> list[dict[str, object]]:
    """An exception and its causes, without local variables, which may hold passwords."""
    found: list[dict[str, object]] = []
    while error is not None and len(found) < _MOST_CAUSES:
        trace = traceback.extract_tb(error.__traceback__)
        frames = [{"filename": each.filename, "lineno": each.lineno, "name": each.name} for each in trace]
        found.append({"exc_type": type(error).__name__, "exc_value": str(error), "frames": frames})
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)
    return found
