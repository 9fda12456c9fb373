"""File descriptors: enough of them for all visitors, and some kept for the SPI device, whatever visitors take.

Each link takes one. So does each connection that is opened on the TLS port and left silent, for at least 10 s, and
Zenoh has no limit for those. Without one left, a device that failed could not be opened again, and no Stop would reach
the robot.
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
"""What the service takes itself, 22 with TLS, metrics and a real device, and what opens one for a moment."""
NEEDED: Final = OWN + MAX_SESSIONS + ACCEPT_PENDING
GIVEN_UP: Final = 2
"""At once: a device takes one, and an emulated one (umockdev) two."""
SPARES: Final = 3 * GIVEN_UP
"""For more than one try: Zenoh may take them in the microseconds between giving them up and opening the device."""


def ensure() -> None:
    """See to it that there are enough, as far as the hard limit goes. Raises ConfigError.

    With too few, Zenoh opens and hears nobody, or nobody else: better not to start.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _taken() + NEEDED
    if soft < wanted <= hard:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
            soft = wanted
    if soft < wanted:
        raise ConfigError(
            f"only {soft} files may be open at once, and the gateway needs {wanted} for itself and its visitors; "
            f"raise the limit: LimitNOFILE={wanted} in a service unit, `ulimit -n {wanted}` in a shell"
        )


def _taken() -> int:
    try:
        return len(list(Path("/proc/self/fd").iterdir()))
    except OSError:  # no /proc, or not even one descriptor left to look
        return 0


class Spare:
    """Descriptors that are kept, to be given up for the SPI device when no other is left."""

    def __init__(self) -> None:
        self._kept: list[int] = []
        self.fill()

    def give_up(self) -> bool:
        """Free some for what is opened next; false if there were none left."""
        given_up, self._kept = self._kept[:GIVEN_UP], self._kept[GIVEN_UP:]
        for number in given_up:
            os.close(number)
        return bool(given_up)

    def fill(self) -> None:
        """Take back what is missing, as far as there are any; at once after a device is opened or closed."""
        with suppress(OSError):
            while len(self._kept) < SPARES:
                self._kept.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))


def ran_out(error: BaseException) -> bool:
    """Whether something could not be opened for want of a descriptor."""
    return isinstance(error, OSError) and error.errno == errno.EMFILE
