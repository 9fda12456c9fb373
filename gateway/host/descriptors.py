"""File descriptors: enough for all clients, and a reserve for what stops the robot.

Each link takes one, and each silent connection to the TLS port takes one for at least 10 s; Zenoh limits neither. With
none left, a failed SPI device, UART or power board could not be reopened, and no Stop would reach the robot.
"""

import errno
import os
from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeVar

from gateway.errors import ConfigError
from gateway.zenoh.limits import ACCEPT_PENDING, MAX_SESSIONS

OWN: Final = 48
"""Descriptors of the service itself: 22 with TLS, metrics and a real device, and room for files opened briefly."""
NEEDED: Final = OWN + MAX_SESSIONS + ACCEPT_PENDING
_EACH: Final = 2
"""Released for each attempt: an SPI device needs one (an emulated one two), a UART by pyserial five."""
SPARES: Final = 4 * _EACH
"""Four attempts, since Zenoh may take the released descriptors before the device is opened."""
T = TypeVar("T")


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
    """A reserve of open descriptors, released for a device when no other is left. Of 0: no reserve."""

    def __init__(self, most: int = SPARES) -> None:
        self._most = most
        self._kept: list[int] = []
        self.fill()

    def give_up(self) -> bool:
        """Release some for what is opened next. Return False if none were left."""
        released, self._kept = self._kept[:_EACH], self._kept[_EACH:]
        for number in released:
            os.close(number)
        return bool(released)

    def open(self, opener: Callable[[], T]) -> T:
        """Return what `opener` opens, or raise its error. Clients may hold all other descriptors."""
        try:
            while True:
                more = self.give_up()
                try:
                    return opener()
                except Exception as error:
                    if not more or not _lacks_descriptors(error):
                        raise
        finally:
            self.fill()

    def fill(self) -> None:
        """Refill the reserve as far as possible. Call it after a device was closed."""
        with suppress(OSError):
            while len(self._kept) < self._most:
                self._kept.append(os.open(os.devnull, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0)))


NO_SPARE: Final = Spare(0)


def _lacks_descriptors(error: BaseException | None) -> bool:
    """Return whether this error, or one that it was raised from, is that no descriptor is left."""
    return error is not None and (getattr(error, "errno", None) == errno.EMFILE or _lacks_descriptors(error.__cause__))
