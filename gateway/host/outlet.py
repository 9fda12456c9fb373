"""Writes to a descriptor without ever holding up whoever has something to say.

Whatever reads stdout or stderr may stop reading: a pipe that is full, a terminal that is held, a stuck journal. Who
writes there then waits, and on the loop every Stop would wait with it. So only a thread of its own writes.
"""

import io
import logging
import os
import select
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Final

from gateway.host.realtime import PAGE_PRIORITY, prefer_thread

KEPT: Final = 1000
"""Lines that wait at most, some 1 MB. What comes then is dropped until half of them are written."""


class Outlet:
    """One descriptor, its queue and its thread.

    `put` never waits. (`SimpleQueue` has no lock that a thread could hold while it waits for a processor; as many
    lines more than `KEPT` may wait as threads put one in the same moment.)
    """

    def __init__(self, descriptor: int, render: Callable[[logging.LogRecord], str] = logging.LogRecord.getMessage):
        self.descriptor = descriptor
        self.dropped = 0
        """Lines that were not written: nobody read what came before them, or the descriptor rejected them."""
        self._render = render
        self._waiting: SimpleQueue[logging.LogRecord | str | None] = SimpleQueue()
        self._full = False
        self._thread = threading.Thread(target=self._run, name=f"outlet-{descriptor}", daemon=True)
        self._thread.start()

    def put(self, item: logging.LogRecord | str) -> None:
        """Have this written: a record as one line, a text as it is."""
        waiting = self._waiting.qsize()
        if waiting >= KEPT or (self._full and waiting > KEPT // 2):
            self._full = True
            self.dropped += 1
            return
        self._full = False
        self._waiting.put(item)

    def close(self, timeout_s: float) -> None:
        """Write what waits, if that takes no longer than this."""
        self._waiting.put(None)
        self._thread.join(timeout_s)

    # ---- on the thread

    def _run(self) -> None:
        # While it renders it holds the interpreter's lock, and must then not be put aside: see realtime.
        prefer_thread(PAGE_PRIORITY)
        told = 0
        while (item := self._waiting.get()) is not None:
            written = self._write(item)
            dropped = self.dropped
            if written and dropped != told and self._waiting.qsize() <= KEPT // 2:
                self._write(_left_out(dropped - told))
                told = dropped

    def _write(self, item: logging.LogRecord | str) -> bool:
        try:
            text = item if isinstance(item, str) else f"{self._render(item)}\n"
            self._write_bytes(text.encode(errors="backslashreplace"))
        except Exception:  # a full disk, a reader that went, a line that cannot be rendered: the next may do
            self.dropped += 1
            return False
        return True

    def _write_bytes(self, data: bytes) -> None:
        # Past Python's own buffers: their lock, held by a thread that waits here, would abort the interpreter's end.
        while data:
            try:
                data = data[os.write(self.descriptor, data) :]
            except BlockingIOError:  # somebody who shares the terminal has made it non-blocking
                select.select([], [self.descriptor], [])


def _left_out(lines: int) -> logging.LogRecord:
    detail = f"{lines} lines were left out here, since nobody read them in time"
    return logging.LogRecord(__name__, logging.WARNING, __file__, 0, detail, None, None)


class _Line(threading.local):
    text = ""


class Stream(io.TextIOBase):
    """In place of `sys.stdout` or `sys.stderr`: for a result, a library's words, the traceback of a thread."""

    def __init__(self, outlet: Outlet) -> None:
        self._outlet = outlet
        self._unfinished = _Line()

    def write(self, text: str) -> int:
        lines, end, rest = (self._unfinished.text + text).rpartition("\n")
        self._unfinished.text = rest
        if end:
            self._outlet.put(lines + end)
        return len(text)

    def flush(self) -> None:
        """Pass on what is no whole line yet. Waits for nothing."""
        rest, self._unfinished.text = self._unfinished.text, ""
        if rest:
            self._outlet.put(rest)

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._outlet.descriptor

    def isatty(self) -> bool:
        return os.isatty(self._outlet.descriptor)
