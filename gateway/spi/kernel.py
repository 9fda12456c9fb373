"""The real device: Linux's spidev, opened for HexapodProtocol v1.0.0 (mode 0, 8 bits, most significant bit first)."""

import fcntl
from pathlib import Path

from gateway.errors import SpiError


class KernelDevice:
    """`/dev/spidevB.C` through the `spidev` package; one `transfer` is one write, and so one chip-select cycle."""

    def __init__(self, path: str, speed_hz: int, *, exclusive: bool = True) -> None:
        """Open and set up the device. Raises SpiError with one sentence that says what is missing.

        `exclusive`: refuse a device that another gateway holds, since two writers would undo each other's Stops.
        """
        try:
            import spidev  # noqa: PLC0415  (a laptop has no spidev, and needs none)
        except ImportError as error:
            raise SpiError(
                "the Python package spidev is missing; install hexapod-gateway[spi], "
                "or try --sim for a simulated controller"
            ) from error
        self._path = path
        self._spi = spidev.SpiDev()
        try:
            self._spi.open_path(path)
            if exclusive:
                fcntl.flock(self._spi.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._spi.mode = 0
            self._spi.bits_per_word = 8
            self._spi.lsbfirst = False
            self._spi.max_speed_hz = speed_hz
        except OSError as error:
            self.close()
            raise SpiError(_why_not_opened(path, error)) from error

    def transfer(self, data: bytes) -> None:
        """Write `data` in one transaction. Raises SpiError."""
        try:
            self._spi.writebytes2(data)
        except OSError as error:
            raise SpiError(f"{self._path}: the transfer failed: {error.strerror or error}") from error

    def close(self) -> None:
        """Release the device."""
        self._spi.close()


def _why_not_opened(path: str, error: OSError) -> str:
    if isinstance(error, BlockingIOError):
        return f"{path} is held by another gateway; stop that one first"
    if isinstance(error, PermissionError):
        return f"{path} may not be opened by this user; add the user to the device's group (spi), or try --sim"
    if not Path(path).exists():
        return f"{path} does not exist; switch SPI on (dtparam=spi=on), or try --sim for a simulated controller"
    return f"{path} cannot be opened: {error.strerror or error}; --sim runs with a simulated controller"
