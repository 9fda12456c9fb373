"""The used part of the Python package spidev, made of system calls, for machines without a usable package.

PyPI has spidev as source only, and a robot may have neither a compiler nor a network. Debian 12 and 13 have spidev 3.6,
which cannot open a device by its path. The names are spidev's; the calls are those of linux/spi/spidev.h.
"""

import fcntl
import os
from typing import Any, Final

_READ_MODE: Final = 2 << 30 | 1 << 16 | ord("k") << 8 | 1
"""SPI_IOC_RD_MODE."""
_CLOSED: Final = -1

USED: Final = "the gateway makes the kernel's calls itself: the Python package spidev is missing, or too old"


def spi_dev() -> Any:
    """Return spidev's class, or this module's if the package is missing, too old, or built for another Python."""
    try:
        import spidev  # noqa: PLC0415
    except ImportError:
        return SpiDev
    return spidev.SpiDev if hasattr(spidev.SpiDev, "open_path") else SpiDev


def are_used() -> bool:
    """Return whether this module is used instead of spidev."""
    return spi_dev() is SpiDev


class SpiDev:
    """One opening of `/dev/spidevB.C`. Its methods raise OSError if a call fails."""

    def __init__(self) -> None:
        self._fd = _CLOSED

    def open_path(self, path: str) -> None:
        """Open the device. Raises OSError if it is no SPI device."""
        fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            fcntl.ioctl(fd, _READ_MODE, bytes(1))
        except OSError:
            os.close(fd)
            raise
        self.close()
        self._fd = fd

    def fileno(self) -> int:
        """Return the device's file descriptor, or -1 while it is closed."""
        return self._fd

    def close(self) -> None:
        """Release the device. Closing twice is harmless."""
        fd, self._fd = self._fd, _CLOSED
        if fd != _CLOSED:
            os.close(fd)
