"""What waits for a reader, what is dropped meanwhile, and how that is said."""

import logging
import os
from collections.abc import Iterator
from contextlib import suppress
from typing import IO

import pytest

from gateway.robot.host.outlet import KEPT, Outlet, Stream


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


def test_nobody_waits_and_what_was_dropped_is_said_once(pipe: Pipe) -> None:
    outlet = Outlet(pipe.theirs)
    for number in range(2 * KEPT):
        outlet.put(f"{number}\n")
    dropped = outlet.dropped
    assert KEPT - 1 <= dropped <= KEPT, "the thread may have taken one before the others came"
    lines = pipe.lines()
    kept = [next(lines) for _ in range(2 * KEPT - dropped + 1)]
    said = f"{dropped} lines were left out here, since nobody read them in time"
    assert kept.count(said) == 1
    kept.remove(said)
    assert kept == [str(number) for number in range(2 * KEPT - dropped)]
    outlet.put("it flows again\n")
    assert next(lines) == "it flows again"
    outlet.close(10)
    assert outlet.dropped == dropped


def test_while_most_of_it_waits_nothing_more_is_taken(pipe: Pipe) -> None:
    """So that the lines between two gaps belong together."""
    outlet = Outlet(pipe.theirs)
    line = "x" * 1000
    for _ in range(2 * KEPT):
        outlet.put(f"{line}\n")
    dropped = outlet.dropped
    lines = pipe.lines()
    assert next(lines) == line
    outlet.put("more\n")  # the pipe has room for 64 lines, and not for half of those that wait
    assert outlet.dropped == dropped + 1
    left = [next(lines) for _ in range(2 * KEPT - dropped)]
    assert left.count(line) == len(left) - 1, "and the line that says how many are missing"
    outlet.close(10)


def test_a_descriptor_that_rejects_holds_nobody() -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    outlet = Outlet(full)
    for _ in range(5):
        outlet.put("lost\n")
    outlet.close(10)
    os.close(full)
    assert outlet.dropped == 5


def test_a_line_that_cannot_be_rendered_is_dropped_and_the_next_is_written() -> None:
    ours, theirs = os.pipe()
    outlet = Outlet(theirs)
    for message, arguments in (("%d", ("no number",)), ("next", ())):
        outlet.put(logging.LogRecord("test", logging.INFO, __file__, 1, message, arguments, None))
    outlet.close(10)
    os.close(theirs)
    with os.fdopen(ours) as reader:
        assert reader.read() == "next\n1 lines were left out here, since nobody read them in time\n"


def test_what_is_printed_goes_the_same_way(pipe: Pipe) -> None:
    outlet = Outlet(pipe.theirs)
    stream = Stream(outlet)
    lines = pipe.lines()
    print("a", "result", file=stream)
    stream.write("two\nlines and a part")
    assert [next(lines) for _ in range(2)] == ["a result", "two"]
    print(flush=True, file=stream)
    assert next(lines) == "lines and a part"
    outlet.close(10)
