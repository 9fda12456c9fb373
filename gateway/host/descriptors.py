"""File descriptors: enough for all clients, and some that are kept for the SPI device.

Each link takes one. So does each connection that is opened on the TLS port and left silent, for at least 10 s, and
Zenoh does not limit those. Without a free descriptor, a device that failed could not be opened again, and no Stop would
reach the robot.
"""

import errno
import os
import resource
from contextlib import suppress
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError
from gateway.limits import ACCEPT_PENDING, MAX_SESSIONS

OWN: Final = 48
"""What the service itself takes: 22 with TLS, metrics and a real device, and room for files open for a moment."""
NEEDED: Final = OWN + MAX_SESSIONS + ACCEPT_PENDING
GIVEN_UP: Final = 2
"""How many are closed for one try to open the device: a real one takes one, an emulated one (umockdev) two."""
SPARES: Final = 3 * GIVEN_UP
"""Enough for three tries: Zenoh may take descriptors between their closing and the opening of the device."""


def ensure(needed: int = NEEDED, program: str = "the gateway") -> None:
    """Raise the soft limit as far as needed. Raises ConfigError where the hard limit is too low.

    With too few, Zenoh would open, but accept no clients, or no more of them.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _taken() + needed
    if soft < wanted <= hard:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
            soft = wanted
    if soft < wanted:
        raise ConfigError(
            f"only {soft} files may be open at once, and {program} needs {wanted} for itself and its clients; "
            f"raise the limit: LimitNOFILE={wanted} in a service unit, `ulimit -n {wanted}` in a shell"
        )


def _taken() -> int:
    try:
        return len(list(Path("/proc/self/fd").iterdir()))
    except OSError:  # no /proc, or not even one descriptor left to look
        return 0


class Spare:
    """Descriptors that are kept open, and closed for the SPI device when no other is left."""

    def __init__(self) -> None:
        self._kept: list[int] = []
        self.fill()

    def give_up(self) -> bool:
        """Close some for the file that is opened next; False if none were left."""
        given_up, self._kept = self._kept[:GIVEN_UP], self._kept[GIVEN_UP:]
        for number in given_up:
            os.close(number)
        return bool(given_up)

    def fill(self) -> None:
        """Open those that are missing, as far as possible. Call it as soon as a device is opened or closed."""
        with suppress(OSError):
            while len(self._kept) < SPARES:
                self._kept.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))


def ran_out(error: BaseException) -> bool:
    """Whether something could not be opened because no descriptor was left."""
    return isinstance(error, OSError) and error.errno == errno.EMFILE
