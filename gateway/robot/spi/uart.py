"""The UART of elkapod-2025, by `pyserial`, with a write that never waits, as a Stop needs it."""

import errno
import os
from contextlib import suppress
from functools import partial
from typing import Final, Protocol

from gateway.errors import DeviceHeldError, SpiError
from gateway.host.descriptors import NO_SPARE, Spare
from gateway.model.elkapod import UART_BAUD
from gateway.words.own_command import install

_MOST_BYTES: Final = 4096
"""The kernel's buffer for a UART, so that one call empties it."""


class Uart(Protocol):
    """A UART, real or simulated."""

    def write(self, data: bytes) -> None:
        """Hand a message to the kernel, without waiting. Raises SpiError if it takes less than all of it."""

    def read(self) -> bytes:
        """Return the bytes received since the last call, without waiting. Raises SpiError if the UART is gone."""

    def close(self) -> None:
        """Release the UART. Never raises."""


class SerialUart(Uart):
    """`/dev/tty…`, opened and set up by pyserial: 8 bits, no parity, two stop bits, no flow control.

    Reads and writes bypass pyserial, whose `select` takes no descriptor from 1024 on: clients may hold that many.
    """

    def __init__(self, path: str, *, exclusive: bool = True, spare: Spare = NO_SPARE) -> None:
        """Open and set up the UART. `exclusive` (not for `stop-servos`) rejects a UART that another gateway holds.

        `spare` are descriptors kept for it while it is closed. Raises SpiError with a sentence that states what is
        missing.
        """
        try:
            import serial  # noqa: PLC0415  (a laptop needs none)
        except ImportError as error:
            raise SpiError(f"pyserial is not installed: {install('spi')}") from error
        self._path = path
        self._spare = spare
        lock = True if exclusive else None
        two = serial.STOPBITS_TWO
        # inter_byte_timeout sets VMIN to 1. With pyserial's own VMIN of 0, reading nothing looks like an end.
        opener = partial(serial.Serial, path, UART_BAUD, stopbits=two, inter_byte_timeout=0, exclusive=lock)
        try:
            self._serial = spare.open(opener)
        except (OSError, ValueError) as error:
            kind = DeviceHeldError if getattr(error, "errno", None) == errno.EAGAIN else SpiError
            raise kind(f"the UART {path} cannot be opened: {error}; name another with controller.uart") from error

    def write(self, data: bytes) -> None:
        try:
            written = os.write(self._serial.fileno(), data)
        except OSError as error:
            raise SpiError(f"{self._path}: a message could not be written: {error.strerror or error}") from error
        if written != len(data):
            raise SpiError(f"{self._path}: {written} of {len(data)} bytes of a message were written")

    def read(self) -> bytes:
        try:
            data = os.read(self._serial.fileno(), _MOST_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise SpiError(f"{self._path}: cannot be read: {error.strerror or error}") from error
        if not data:
            raise SpiError(f"{self._path}: is disconnected")
        return data

    def close(self) -> None:
        with suppress(OSError):
            self._serial.close()
        self._spare.fill()
