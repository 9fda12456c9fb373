"""The real device: Linux's spidev, with 8 bits, the most significant first; mode 0 for HexapodProtocol v1.0.0.

The Python package spidev opens it, or `open` on a machine without a usable package. PyPI has spidev as source only, and
a robot may have neither a compiler nor a network. Debian 12 and 13 have spidev 3.6, which cannot open a device by path.
"""

import array
import errno
import fcntl
import io
import struct
import sys
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from gateway.errors import BatchRejectedError, DeviceHeldError, SpiError
from gateway.host.descriptors import NO_SPARE, Spare
from gateway.robot.spi import Batch, DuplexDevice, SpiDevice
from gateway.robot.spi.outside import Listener

NO_SPIDEV: Final = "the gateway makes the kernel's calls itself: the Python package spidev is missing, or too old"
_MOST_TRANSFERS: Final = 32
"""The longest list has 1024 bytes; up to this size Python lets other threads run during an `ioctl`."""
BUFSIZ: Final = Path("/sys/module/spidev/parameters/bufsiz")
_DEFAULT_BUFSIZ: Final = 4096
_ALIGNED: Final = 128
"""The least part of spidev's buffer that a transfer takes: ARCH_DMA_MINALIGN, 128 bytes on a Raspberry Pi's arm64."""
_LONGEST: Final = 128  # bytes of a transfer; the longest frames have 14 and 80
_SEGMENT: Final = struct.Struct("=QQIIHBBBBBB")
"""struct spi_ioc_transfer: tx_buf, rx_buf, len, speed_hz, delay_usecs, bits_per_word, cs_change, and four that stay 0.
Speed and bits of 0 would mean the device's own, which every program that opens the device can change."""
_BITS: Final = 8
_NO_LISTS: Final = (errno.EINVAL, errno.EMSGSIZE)


def _ioctl(direction: int, size: int, number: int) -> int:
    return direction << 30 | size << 16 | ord("k") << 8 | number


_MESSAGES: Final = tuple(_ioctl(1, count * _SEGMENT.size, 0) for count in range(_MOST_TRANSFERS + 1))
"""SPI_IOC_MESSAGE(count)."""
_WRITE_MODE: Final = _ioctl(1, 1, 1)
_WRITE_BITS: Final = _ioctl(1, 1, 3)
_WRITE_SPEED: Final = _ioctl(1, 4, 4)
_READ_MODE: Final = _ioctl(2, 4, 5)
"""SPI_IOC_RD_MODE32."""


def spidev_module() -> Any:
    """Return the package spidev, or None if it is missing, too old, or built for another Python."""
    try:
        import spidev  # noqa: PLC0415
    except ImportError:
        return None
    return spidev if hasattr(spidev.SpiDev, "open_path") else None


class KernelDevice(SpiDevice, DuplexDevice):
    """`/dev/spidevB.C`. A batch is one SPI_IOC_MESSAGE, so it is atomic on its bus.

    Mode, speed and bits belong to the device, so another program may change them at any time. Therefore each segment
    contains speed and bits, and `put_right` checks the mode, which no segment has.
    """

    _spi: Any = None

    def __init__(
        self, path: str, speed_hz: int, *, mode: int = 0, exclusive: bool = True, spare: Spare = NO_SPARE
    ) -> None:
        """Open and set up the device. Raises SpiError with a sentence that states what is missing.

        `mode` is clock polarity and phase, 0 to 3. `exclusive` rejects a device that another gateway holds, since two
        writers would undo each other's Stops. `spare` are descriptors kept for this device while it is closed.
        """
        self._path = path
        self._spare = spare
        self._speed_hz = speed_hz
        self._flags = bytes((mode,))
        self._listener: Listener | None = None
        self.most_transfers = _most_transfers()
        self._data = array.array("B", bytes(_MOST_TRANSFERS * _LONGEST))
        self._bytes = memoryview(self._data)
        # Transfers without a receive buffer lost clock edges on a Raspberry Pi 5. Only `exchange` reads the buffer.
        self._received = array.array("B", bytes(_LONGEST))
        self._at = self._data.buffer_info()[0], self._received.buffer_info()[0]
        # Every exception counts as a fault of the device: spidev has raised SystemError and TypeError when a kernel
        # behaved unexpectedly, and the gateway must get to its Stops.
        try:
            spare.open(self._open)
            if exclusive:
                self._listener = Listener(self._spi.fileno())
            # This clears all flags: a flag of another program, such as "no chip select", outlives that program, and
            # spidev's own `mode` changes two bits only.
            fcntl.ioctl(self._spi, _WRITE_MODE, self._flags)
            fcntl.ioctl(self._spi, _WRITE_BITS, bytes((_BITS,)))
            fcntl.ioctl(self._spi, _WRITE_SPEED, struct.pack("=I", speed_hz))
            # The mode may differ from the flags: some kernels add SPI_CS_HIGH if chip select is a GPIO.
            self._mode = self._read_mode()
        except Exception as error:
            self.close()
            kind = DeviceHeldError if isinstance(error, BlockingIOError) else SpiError
            raise kind(_why_not_opened(path, error)) from error

    def _open(self) -> None:
        """Open the device by spidev, or without it as a file."""
        spidev = spidev_module()
        if spidev is None:
            self._spi = io.FileIO(self._path, "r+")
        else:
            self._spi = spidev.SpiDev()
            self._spi.open_path(self._path)

    def transfer(self, batch: Batch) -> None:
        """Write the batch in one call. Raises SpiError if the transfer fails.

        Raises BatchRejectedError if the kernel rejects the list: it checks the whole list before the first bit leaves.
        """
        try:
            parts, pauses_us = zip(*batch, strict=True)
            data, sizes = b"".join(parts), tuple(map(len, parts))
            self._bytes[: len(data)] = data
            sent = fcntl.ioctl(self._spi, *_segments(sizes, pauses_us, *self._at, self._speed_hz))
        except Exception as error:
            if isinstance(error, OSError) and error.errno in _NO_LISTS:
                what = f"the kernel rejects a list of {len(batch)} transfers: {_cause_of(error)}"
                raise BatchRejectedError(f"{self._path}: {what}") from error
            raise SpiError(f"{self._path}: the transfer failed: {_cause_of(error)}") from error
        if sent != len(data):
            raise SpiError(f"{self._path}: the transfer failed: {sent} of {len(data)} bytes were written")

    def exchange(self, data: bytes) -> bytes:
        """Write `data`; return the bytes that the controller sent meanwhile. Raises SpiError if the transfer fails."""
        self.transfer(((data, 0),))
        return self._received[: len(data)].tobytes()

    def stop_servos_at_work(self) -> bool | None:
        """As in `OpenDevice`; None also if not `exclusive`."""
        return None if self._listener is None else self._listener.poll()

    def put_right(self) -> str | None:
        """As in `OpenDevice`, for the mode. A changed speed alone does no harm and is not checked."""
        try:
            mode = self._read_mode()
            if mode == self._mode:
                return None
        except (OSError, ValueError):  # the device is going away, and the next transfer will report it
            return None
        with suppress(OSError):
            fcntl.ioctl(self._spi, _WRITE_MODE, self._flags)
        return f"{self._path}: another program had set SPI mode 0x{mode:02x} instead of 0x{self._mode:02x}"

    def _read_mode(self) -> int:
        value = bytearray(4)
        fcntl.ioctl(self._spi, _READ_MODE, value)
        return int.from_bytes(value, sys.byteorder)

    def close(self) -> None:
        self._listener = None
        with suppress(Exception):
            self._spi.close()
        self._spare.fill()


@lru_cache(maxsize=256)
def _segments(
    sizes: tuple[int, ...], pauses_us: tuple[int, ...], data_at: int, received_at: int, speed_hz: int
) -> tuple[int, bytearray]:
    """Return request and list for a batch with these sizes and pauses. Cached: a stream's batches are all alike."""
    segments = bytearray()
    for number, (size, pause_us) in enumerate(zip(sizes, pauses_us, strict=True), 1):
        # cs_change releases chip select after a transfer; after the last one it would keep chip select.
        cs_change = number < len(sizes)
        segments += _SEGMENT.pack(data_at, received_at, size, speed_hz, pause_us, _BITS, cs_change, 0, 0, 0, 0)
        data_at += size
    return _MESSAGES[len(sizes)], segments


def _most_transfers() -> int:
    """Return the number of transfers in the longest batch that spidev's buffer holds."""
    try:
        size = int(BUFSIZ.read_text())
    except (OSError, ValueError):
        size = _DEFAULT_BUFSIZ
    return max(1, min(_MOST_TRANSFERS, size // _ALIGNED))


def _cause_of(error: Exception) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return f"{type(error).__name__}: {error}"


def _why_not_opened(path: str, error: Exception) -> str:
    if isinstance(error, BlockingIOError):
        return f"{path} is held by another gateway; stop that one first"
    if isinstance(error, PermissionError):
        return f"{path} may not be opened by this user; add the user to the device's group (spi), or try --sim"
    if not Path(path).exists():
        return f"{path} does not exist; switch SPI on (dtparam=spi=on), or try --sim for a simulated controller"
    return f"{path} cannot be opened: {_cause_of(error)}; --sim runs with a simulated controller"
