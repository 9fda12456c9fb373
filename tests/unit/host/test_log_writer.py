"""What waits for a reader, what is dropped meanwhile, and how that is said."""

import logging
import os
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


def test_while_most_of_it_waits_nothing_more_is_taken(pipe: Pipe) -> None:
    """So that the lines between two gaps belong together."""
    log_writer = LogWriter(pipe.theirs)
    line = "x" * 1000
    for _ in range(2 * MAX_LINES_WAITING):
        log_writer.put(f"{line}\n")
    dropped = log_writer.dropped
    lines = pipe.lines()
    assert next(lines) == line
    log_writer.put("more\n")  # the pipe has room for 64 lines, and not for half of those that wait
    assert log_writer.dropped == dropped + 1
    left = [next(lines) for _ in range(2 * MAX_LINES_WAITING - dropped)]
    assert left.count(line) == len(left) - 1, "and the line that says how many are missing"
    log_writer.close(10)


def test_a_descriptor_that_rejects_holds_nobody() -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    log_writer = LogWriter(full)
    for _ in range(5):
        log_writer.put("lost\n")
    log_writer.close(10)
    os.close(full)
    assert log_writer.dropped == 5


def test_a_line_that_cannot_be_rendered_is_dropped_and_the_next_is_written() -> None:
    ours, theirs = os.pipe()
    log_writer = LogWriter(theirs)
    for message, arguments in (("%d", ("no number",)), ("next", ())):
        log_writer.put(logging.LogRecord("test", logging.INFO, __file__, 1, message, arguments, None))
    log_writer.close(10)
    os.close(theirs)
    with os.fdopen(ours) as reader:
        assert reader.read() == "next\n1 lines were dropped here, since they were not read in time\n"


def test_what_is_printed_goes_the_same_way(pipe: Pipe) -> None:
    log_writer = LogWriter(pipe.theirs)
    stream = LogStream(log_writer)
    lines = pipe.lines()
    print("a", "result", file=stream)
    stream.write("two\nlines and a part")
    assert [next(lines) for _ in range(2)] == ["a result", "two"]
    print(flush=True, file=stream)
    assert next(lines) == "lines and a part"
    log_writer.close(10)
