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
from pathlib import Path

MESSAGE_BYTES = 10
"""A program writes messages of this length, by which several that came at once are separated."""
_MOST_BYTES = 4096


class PseudoUart:
    """The controller's end. The program's end is a link to a terminal, which goes and comes as an adapter does."""

    def __init__(self, arrived: Callable[[int, bytes], None]) -> None:
        """`arrived` gets each message of the program as it comes, and when."""
        self._arrived = arrived
        self._lock = threading.RLock()
        self._link: Path | None = None
        self._ours = self._theirs = -1
        self._end, self._ended = -1, -1
        self._reader: threading.Thread | None = None

    def attach(self, path: str) -> None:
        """From now on there is a terminal at this path, in which nothing is waiting."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)  # it is kept open here, so the controller's end outlives each program
        os.set_blocking(self._ours, False)
        self._ended, self._end = os.pipe()
        self._link = Path(path)
        self._link.symlink_to(os.ttyname(self._theirs))
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def detach(self) -> None:
        """It goes: opening finds nothing, reading finds an end, and writing answers EIO."""
        if self._reader is None or self._link is None:
            return
        self._link.unlink()
        os.close(self._end)
        self._reader.join()
        with self._lock:
            for descriptor in (self._ours, self._theirs, self._ended):
                os.close(descriptor)
            self._reader = self._link = None

    def send(self, data: str) -> None:
        """The controller sends these bytes (hex). What no program reads is lost, once the kernel keeps no more."""
        with self._lock:
            if self._reader is not None:
                try:
                    os.write(self._ours, bytes.fromhex(data))
                except BlockingIOError:
                    return

    def drain(self) -> None:
        """Take what has come up to now."""
        with self._lock:
            if self._reader is None:
                return
            try:
                data = os.read(self._ours, _MOST_BYTES)
            except BlockingIOError:
                return
            now_ns = time.monotonic_ns()
            for place in range(0, len(data), MESSAGE_BYTES):
                self._arrived(now_ns, data[place : place + MESSAGE_BYTES])

    def _read(self) -> None:
        poll = select.poll()
        poll.register(self._ours, select.POLLIN)
        poll.register(self._ended)
        while all(descriptor != self._ended for descriptor, _ in poll.poll()):
            self.drain()
