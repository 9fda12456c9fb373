"""A UART on a pair of pseudo terminals: a program opens one end, the emulation is the controller at the other.

A part of `spi_testbed.py`, whose Python it runs under; so what is written here and what is exchanged over SPI are one
stream, in the order in which the kernel had it.
"""

import os
import select
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

MESSAGE_BYTES = 10
"""A program writes messages of this length, by which several that came at once are separated."""
_MOST_BYTES = 4096


class PseudoUart:
    """The controller's end, once it is attached. The program's end is a link to a terminal."""

    def __init__(self, arrived: Callable[[int, bytes], None]) -> None:
        """`arrived` gets each message of the program as it comes, and when."""
        self._arrived = arrived
        self._lock = threading.Lock()
        self._ours = -1

    def attach(self, path: str) -> None:
        """From now on there is a terminal at this path, in which nothing is waiting."""
        self._ours, theirs = os.openpty()  # theirs is kept open here, so the controller's end outlives each program
        tty.setraw(theirs)
        os.set_blocking(self._ours, False)
        Path(path).symlink_to(os.ttyname(theirs))
        threading.Thread(target=self._read, daemon=True).start()

    def send(self, data: str) -> None:
        """The controller sends these bytes (hex). What no program reads is lost, once the kernel keeps no more."""
        with self._lock, suppress(BlockingIOError):
            os.write(self._ours, bytes.fromhex(data))

    def drain(self) -> None:
        """Take what has come up to now."""
        with self._lock, suppress(BlockingIOError):
            data = os.read(self._ours, _MOST_BYTES) if self._ours != -1 else b""
            now_ns = time.monotonic_ns()
            for place in range(0, len(data), MESSAGE_BYTES):
                self._arrived(now_ns, data[place : place + MESSAGE_BYTES])

    def _read(self) -> None:
        poll = select.poll()
        poll.register(self._ours, select.POLLIN)
        while poll.poll():
            self.drain()
