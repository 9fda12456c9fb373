"""What waits for a reader, what is dropped meanwhile, and how that is said."""

import logging
import os
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import IO

import pytest

from gateway.host.logs import MAX_LINES_WAITING, LogStream, LogWriter


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
        """What was written since it was full."""
        return (line.rstrip("\n") for line in self.reader if not line.startswith("."))

    def close(self) -> None:
        self.reader.close()
        os.close(self.theirs)


@pytest.fixture(params=[True, False], ids=["blocking", "non-blocking"])
def pipe(request: pytest.FixtureRequest) -> Iterator[Pipe]:
    pipe = Pipe(blocking=request.param)
    yield pipe
    pipe.close()


def test_what_no_reader_takes_in_time_is_dropped_and_counted(pipe: Pipe) -> None:
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


def test_a_line_that_cannot_be_made_and_a_descriptor_that_rejects_hold_nobody() -> None:
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


def test_what_is_printed_goes_the_same_way(pipe: Pipe) -> None:
    log_writer = LogWriter(pipe.theirs)
    stream = LogStream(log_writer)
    lines = pipe.lines()
    print("a", "result", file=stream)
    stream.write("two\nlines and a part")
    assert [next(lines) for _ in range(2)] == ["a result", "two"]
    print(flush=True, file=stream)
    assert next(lines) == "lines and a part"
    log_writer.stop(10)
