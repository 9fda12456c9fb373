"""Writes to stdout or stderr from a background thread.

The reader of stdout or stderr may stop reading: a full pipe, a paused terminal, a stuck journal. Then a write blocks;
on the loop it would delay every Stop.
"""

import io
import logging
import os
import select
import threading
from collections.abc import Callable
from functools import partial
from typing import Final

from gateway.host.worker import Worker

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
