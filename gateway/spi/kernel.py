"""The real device: Linux's spidev, opened for HexapodProtocol v1.0.0 (mode 0, 8 bits, most significant bit first)."""

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from gateway.errors import SpiError
from gateway.host.descriptors import Spare, ran_out
from gateway.spi.outside import Listener

PATIENCE_S: Final = 0.25
PATIENCE_SHARED_S: Final = 1.0
"""How long the gateway, and `stop-servos` on a shared device, wait for the bus lock, once. A frame with its pauses
takes 4 ms, on a busy machine some tens. A program that holds it for longer hangs, and Stops do not wait for that."""
LOCK_PAUSE_S: Final = 0.000_2
_QUEUE, _BUS = 0, 1  # offsets at which the locks lie; the device itself has no bytes


class KernelDevice:
    """`/dev/spidevB.C` through the `spidev` package; one `transfer` is one write, and so one chip-select cycle."""

    def __init__(self, path: str, speed_hz: int, *, exclusive: bool = True, spare: Spare | None = None) -> None:
        """Open and set up the device. Raises SpiError with one sentence that says what is missing.

        `exclusive`: reject a device that another gateway holds, since two writers would undo each other's Stops.
        `spare`: file descriptors that are kept for this device while it is closed.
        """
        try:
            import spidev  # noqa: PLC0415  (a laptop has no spidev, and needs none)
        except ImportError as error:
            raise SpiError(
                "the Python package spidev is missing; install hexapod-gateway[spi], "
                "or try --sim for a simulated controller"
            ) from error
        self._path = path
        self._most_patience_s = self._patience_s = PATIENCE_S if exclusive else PATIENCE_SHARED_S
        self._spare = spare
        self._spi = spidev.SpiDev()
        self._listener: Listener | None = None
        # Any exception counts as a fault of the device: spidev has raised SystemError and TypeError when a kernel
        # behaved unexpectedly, and the gateway must go on to its Stops.
        try:
            self._open(path)
            if exclusive:
                fcntl.flock(self._spi.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._listener = Listener(self._spi.fileno())
            self._spi.mode = 0
            self._spi.bits_per_word = 8
            self._spi.lsbfirst = False
            self._spi.max_speed_hz = speed_hz
        except Exception as error:
            self.close()
            raise SpiError(_why_not_opened(path, error)) from error

    def _open(self, path: str) -> None:
        """Open it. Clients may hold all other descriptors, so spare ones are closed just before."""
        while True:
            more = self._spare is not None and self._spare.give_up()
            try:
                self._spi.open_path(path)
            except Exception as error:
                if not (more and ran_out(error)):
                    raise
            else:
                break
        if self._spare is not None:
            self._spare.fill()

    def transfer(self, data: bytes) -> None:
        """Write `data` in one transaction. Raises SpiError, whatever spidev raises (SystemError if it was short)."""
        try:
            self._spi.writebytes2(data)
        except Exception as error:
            raise SpiError(f"{self._path}: the transfer failed: {_cause_of(error)}") from error

    @contextmanager
    def lock(self) -> Iterator[None]:
        """The bus lock: no other gateway or `stop-servos` writes between the transfers of one frame.

        A Stop from `stop-servos` between an announcement and its body would be lost, and everything after it misread.
        The locks are record locks, independent of the one that `exclusive` takes, and end with their process.
        """
        # The next in line locks the queue while it waits, so a program that writes without a pause cannot keep the bus.
        queued = self._lock(_QUEUE)
        held = self._lock(_BUS)
        if queued:
            self._unlock(_QUEUE)
        try:
            yield
        finally:
            if held:
                self._unlock(_BUS)

    def _lock(self, place: int) -> bool:
        """Wait for a lock, but not for long. False: not locked in time, and the frame is written all the same."""
        give_up_s = time.monotonic() + self._patience_s
        while True:
            try:
                fcntl.lockf(self._spi.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
            except (BlockingIOError, PermissionError):  # another program's frame is under way
                if time.monotonic() > give_up_s:
                    self._patience_s = 0.0
                    return False
                time.sleep(LOCK_PAUSE_S)
            except OSError:  # the device is going away, and the transfer will report it
                return False
            else:
                self._patience_s = self._most_patience_s
                return True

    def _unlock(self, place: int) -> None:
        with suppress(OSError):
            fcntl.lockf(self._spi.fileno(), fcntl.LOCK_UN, 1, place)

    def stop_servos_at_work(self) -> bool:
        """Whether `stop-servos` stops the servos through the same device now; False if not opened as `exclusive`."""
        return self._listener is not None and self._listener.look()

    def close(self) -> None:
        """Release the device."""
        self._listener = None
        with suppress(Exception):
            self._spi.close()
        if self._spare is not None:
            self._spare.fill()


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
