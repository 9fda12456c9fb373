"""python-can's slcan without its waits: it reads a byte at a time, and each write waits until the adapter has it.

With 8 000 frames a second on the bus that alone takes more than a processor. Here a call reads all that has come, and
drops what the power board does not send. python-can's `select` takes no descriptor from 1024 on.
"""

import os
import re
import select
from collections import deque
from typing import Any, Final

from can import CanOperationError, Message
from can.interfaces.slcan import slcanBus

_FRAME: Final = re.compile(rb"t(0[6-9][0-9A-Fa-f])([0-8])((?:[0-9A-Fa-f]{2})*)\r")
"""A classic data frame of the board's identifiers, 060 to 09F: identifier, length, data and perhaps a time stamp."""
_LONGEST: Final = 64
"""Bytes of a line that are kept while its end is missing; a frame has 27 at most."""
_MOST: Final = 65_536
"""Bytes that a call reads."""


class Slcan(slcanBus):
    """An adapter that speaks slcan. It gives the board's frames alone."""

    def __init__(self, channel: str, **kwargs: Any) -> None:
        """As slcanBus."""
        self._left = b""
        self._frames: deque[Message] = deque()
        super().__init__(channel, sleep_after_open=0, **kwargs)
        self._fd: int = self.serialPortOrig.fileno()
        self._readable, self._writable = select.poll(), select.poll()
        self._readable.register(self._fd, select.POLLIN)
        self._writable.register(self._fd, select.POLLOUT)

    def send(self, msg: Message, timeout: float | None = None) -> None:
        """Raises CanOperationError where the adapter takes nothing for so long (s; None: at all)."""
        line = f"t{msg.arbitration_id:03X}{msg.dlc:d}{bytes(msg.data).hex().upper()}\r".encode()
        if not self._writable.poll(timeout and timeout * 1000):
            raise CanOperationError("the adapter takes nothing")
        try:
            written = os.write(self._fd, line)
        except OSError as error:
            raise CanOperationError(f"the adapter takes nothing: {error.strerror}") from error
        if written != len(line):
            raise CanOperationError(f"the adapter took {written} of {len(line)} bytes")

    def _recv_internal(self, timeout: float | None) -> tuple[Message | None, bool]:
        if not self._frames:
            self._read_all(timeout)
        return (self._frames.popleft(), True) if self._frames else (None, False)

    def _read_all(self, timeout: float | None) -> None:
        if not self._readable.poll(timeout and timeout * 1000):
            return
        try:
            data = os.read(self._fd, _MOST)
        except BlockingIOError:
            return
        except OSError as error:
            raise CanOperationError(f"the adapter cannot be read: {error.strerror}") from error
        if not data:
            raise CanOperationError("the adapter is disconnected")
        self._left += data
        end = 0
        for found in _FRAME.finditer(self._left):
            end = found.end()
            length = int(found[2])
            self._frames.append(
                Message(
                    arbitration_id=int(found[1], 16),
                    is_extended_id=False,
                    dlc=length,
                    data=bytes.fromhex(found[3].decode())[:length],
                )
            )
        self._left = self._left[end:][-_LONGEST:]
