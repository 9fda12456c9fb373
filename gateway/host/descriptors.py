"""File descriptors: enough for all clients, and a reserve for the SPI device.

Each link takes one, and each silent connection to the TLS port takes one for at least 10 s; Zenoh limits neither. With
none left, a failed SPI device could not be reopened, and no Stop would reach the robot.
"""

import os
from contextlib import suppress
from typing import Final

from gateway.errors import ConfigError
from gateway.limits import ACCEPT_PENDING, MAX_SESSIONS

OWN: Final = 48
"""Descriptors of the service itself: 22 with TLS, metrics and a real device, and room for files opened briefly."""
NEEDED: Final = OWN + MAX_SESSIONS + ACCEPT_PENDING
SPARES_PER_OPENING: Final = 2
"""Closed for each attempt to open the device: a real one needs one, an emulated one (umockdev) two."""
SPARES: Final = 3 * SPARES_PER_OPENING
"""Three attempts, since Zenoh may take the released descriptors before the device is opened."""


def ensure(needed: int = NEEDED, program: str = "the gateway") -> None:
    """Raise the soft limit to the open files plus `needed`. Raises ConfigError if the hard limit is too low.

    With too few descriptors, Zenoh would open but reject clients.
    """
    try:
        import resource  # noqa: PLC0415
    except ImportError:  # Windows has no such limit
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = needed
    with suppress(OSError):  # no /proc, or no descriptor left to list it
        wanted += len(os.listdir("/proc/self/fd"))
    if soft < wanted <= hard:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
            soft = wanted
    if soft < wanted:
        raise ConfigError(
            f"only {soft} files may be open at once, and {program} needs {wanted} for itself and its clients; "
            f"raise the limit: LimitNOFILE={wanted} in a service unit, `ulimit -n {wanted}` in a shell"
        )


class Spare:
    """A reserve of open descriptors, released for the SPI device when no other is left."""

    def __init__(self) -> None:
        self._kept: list[int] = []
        self.fill()

    def give_up(self) -> bool:
        """Close SPARES_PER_OPENING for the file opened next. Return False if none were left."""
        given_up, self._kept = self._kept[:SPARES_PER_OPENING], self._kept[SPARES_PER_OPENING:]
        for number in given_up:
            os.close(number)
        return bool(given_up)

    def fill(self) -> None:
        """Refill the reserve as far as possible. Call it after a device was opened or closed."""
        with suppress(OSError):
            while len(self._kept) < SPARES:
                self._kept.append(os.open(os.devnull, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0)))
