"""The real device: Linux's spidev, with 8 bits, the most significant first; mode 0 for HexapodProtocol v1.0.0."""

import array
import errno
import fcntl
import struct
import sys
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from gateway.errors import BatchRejectedError, SpiError
from gateway.host.descriptors import Spare
from gateway.robot.spi import Batch, DuplexDevice, SpiDevice, ioctls
from gateway.robot.spi.outside import Listener

_MOST_TRANSFERS: Final = 32
"""The longest list has 1024 bytes; up to this size Python lets other threads run during an `ioctl`."""
BUFSIZ: Final = Path("/sys/module/spidev/parameters/bufsiz")
DEFAULT_BUFSIZ: Final = 4096
_ALIGNED: Final = 128
"""The least part of spidev's buffer that a transfer takes: ARCH_DMA_MINALIGN, 128 bytes on a Raspberry Pi's arm64."""
_LONGEST: Final = 128  # bytes of a transfer; the longest frames have 14 and 80
_SEGMENT: Final = struct.Struct("=QQIIHBBBBBB")
"""struct spi_ioc_transfer: tx_buf, rx_buf, len, speed_hz, delay_usecs, bits_per_word, cs_change, and four that stay 0.
Speed and bits of 0 would mean the device's own, which every program that opens the device can change."""
_MESSAGES: Final = tuple(1 << 30 | count * _SEGMENT.size << 16 | ord("k") << 8 for count in range(_MOST_TRANSFERS + 1))
"""SPI_IOC_MESSAGE(count)."""
_BITS: Final = 8
_WRITE_MODE: Final = 1 << 30 | 1 << 16 | ord("k") << 8 | 1
"""SPI_IOC_WR_MODE."""
_READ_MODE: Final = 2 << 30 | 4 << 16 | ord("k") << 8 | 5
"""SPI_IOC_RD_MODE32."""
_WRITE_BITS: Final = 1 << 30 | 1 << 16 | ord("k") << 8 | 3
"""SPI_IOC_WR_BITS_PER_WORD."""
_WRITE_SPEED: Final = 1 << 30 | 4 << 16 | ord("k") << 8 | 4
"""SPI_IOC_WR_MAX_SPEED_HZ."""
_NO_LISTS: Final = (errno.EINVAL, errno.EMSGSIZE)


class KernelDevice(SpiDevice, DuplexDevice):
    """`/dev/spidevB.C`, opened by the `spidev` package. A batch is one SPI_IOC_MESSAGE, so it is atomic on its bus.

    Mode, speed and bits belong to the device, so another program may change them at any time. Therefore each segment
    contains speed and bits, and `put_right` checks the mode, which no segment has.
    """

    _spi: Any = None

    def __init__(
        self, path: str, speed_hz: int, *, mode: int = 0, exclusive: bool = True, spare: Spare | None = None
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
        self.most_transfers = most_transfers()
        self._data = array.array("B", bytes(_MOST_TRANSFERS * _LONGEST))
        self._data_at = self._data.buffer_info()[0]
        self._bytes = memoryview(self._data)
        # Transfers without a receive buffer lost clock edges on a Raspberry Pi 5. Only `exchange` reads the buffer.
        self._received = array.array("B", bytes(_LONGEST))
        self._received_at = self._received.buffer_info()[0]
        # Every exception counts as a fault of the device: spidev has raised SystemError and TypeError when a kernel
        # behaved unexpectedly, and the gateway must get to its Stops.
        try:
            self._open(path)
            if exclusive:
                fcntl.flock(self._spi.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._listener = Listener(self._spi.fileno())
            # This clears all flags: a flag of another program, such as "no chip select", outlives that program, and
            # spidev's own `mode` changes two bits only.
            fcntl.ioctl(self._spi, _WRITE_MODE, self._flags)
            fcntl.ioctl(self._spi, _WRITE_BITS, bytes((_BITS,)))
            fcntl.ioctl(self._spi, _WRITE_SPEED, struct.pack("=I", speed_hz))
            # The mode may differ from the flags: some kernels add SPI_CS_HIGH if chip select is a GPIO.
            self._mode = self._read(_READ_MODE)
        except Exception as error:
            self.close()
            raise SpiError(_why_not_opened(path, error)) from error

    def _open(self, path: str) -> None:
        """Open the device. Clients may hold all other descriptors, so spare ones are closed first."""
        while True:
            more = self._spare is not None and self._spare.give_up()
            try:
                self._spi = ioctls.open_device(path)
            except Exception as error:
                if not (more and isinstance(error, OSError) and error.errno == errno.EMFILE):
                    raise
            else:
                break
        if self._spare is not None:
            self._spare.fill()

    def transfer(self, batch: Batch) -> None:
        """Write the batch in one call. Raises SpiError if the transfer fails.

        Raises BatchRejectedError if the kernel rejects the list: it checks the whole list before the first bit leaves.
        """
        self._write(batch)

    def exchange(self, data: bytes) -> bytes:
        """Write `data`; return the bytes that the controller sent meanwhile. Raises SpiError if the transfer fails."""
        self._write(((data, 0),), answered=True)
        return self._received[: len(data)].tobytes()

    def _write(self, batch: Batch, *, answered: bool = False) -> None:
        """Write the batch in one call, as in `transfer`; with `answered`, as in `exchange`."""
        try:
            parts, pauses_us = zip(*batch, strict=True)
            data, sizes = b"".join(parts), tuple(map(len, parts))
            self._bytes[: len(data)] = data
            at = self._data_at, self._received_at
            try:
                sent = fcntl.ioctl(self._spi, *_segments(sizes, pauses_us, *at, self._speed_hz))
            except OSError as error:
                if error.errno != errno.EINVAL or not self._received_at or answered:
                    raise
                # An SPI controller that cannot receive while it sends rejects receive buffers. Nothing was written.
                sent = fcntl.ioctl(self._spi, *_segments(sizes, pauses_us, self._data_at, 0, self._speed_hz))
                self._received_at = 0  # the receive buffers were the cause
        except Exception as error:
            if not answered and isinstance(error, OSError) and error.errno in _NO_LISTS:
                raise BatchRejectedError(
                    f"{self._path}: the kernel rejects a list of {len(batch)} transfers: {_cause_of(error)}"
                ) from error
            raise SpiError(f"{self._path}: the transfer failed: {_cause_of(error)}") from error
        if sent != len(data):
            raise SpiError(f"{self._path}: the transfer failed: {sent} of {len(data)} bytes were written")

    def stop_servos_at_work(self) -> bool | None:
        """As in `OpenDevice`; None also if not `exclusive`."""
        return None if self._listener is None else self._listener.poll()

    def put_right(self) -> str | None:
        """As in `OpenDevice`, for the mode. A changed speed alone does no harm and is not checked."""
        try:
            mode = self._read(_READ_MODE)
            if mode == self._mode:
                return None
        except (OSError, ValueError):  # the device is going away, and the next transfer will report it
            return None
        with suppress(OSError):
            fcntl.ioctl(self._spi, _WRITE_MODE, self._flags)
        return f"{self._path}: another program had set SPI mode 0x{mode:02x} instead of 0x{self._mode:02x}"

    def _read(self, request: int) -> int:
        value = bytearray(request >> 16 & 0x3FFF)
        fcntl.ioctl(self._spi, request, value)
        return int.from_bytes(value, sys.byteorder)

    def close(self) -> None:
        self._listener = None
        with suppress(Exception):
            self._spi.close()
        if self._spare is not None:
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


def most_transfers(bufsiz: Path = BUFSIZ) -> int:
    """Return the number of transfers in the longest batch that spidev's buffer (`bufsiz`) holds."""
    try:
        size = int(bufsiz.read_text())
    except (OSError, ValueError):
        size = DEFAULT_BUFSIZ
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
