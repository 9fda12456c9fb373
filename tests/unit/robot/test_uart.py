"""The UART by pyserial, on a pair of pseudo terminals."""

import os
import tty
from collections.abc import Iterator

import pytest

from gateway.errors import SpiError
from gateway.model.elkapod import SHUTDOWN
from gateway.robot.spi.uart import SerialUart


@pytest.fixture
def ends() -> Iterator[tuple[int, str]]:
    """The controller's end, and the path of the program's."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(theirs)


def test_what_has_come_is_read_without_waiting_and_nothing_is_no_fault(ends: tuple[int, str]) -> None:
    ours, path = ends
    uart = SerialUart(path)
    uart.write(SHUTDOWN)
    assert os.read(ours, 100) == SHUTDOWN
    assert uart.read() == b""
    assert uart.read() == b""
    os.write(ours, b"beat")
    found = b""
    while found != b"beat":
        found += uart.read()
    assert uart.read() == b""
    with pytest.raises(SpiError, match="cannot be opened"):
        SerialUart(path)
    uart.close()
    SerialUart(path).close()
    os.close(ours)


def test_one_that_is_unplugged_says_so(ends: tuple[int, str]) -> None:
    ours, path = ends
    uart = SerialUart(path)
    os.close(ours)
    with pytest.raises(SpiError, match=path):
        uart.read()
    with pytest.raises(SpiError, match=path):
        uart.write(SHUTDOWN)
    uart.close()
    with pytest.raises(SpiError, match=r"controller\.uart"):
        SerialUart(f"{path}9")
