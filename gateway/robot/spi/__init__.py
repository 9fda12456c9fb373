"""The contract of an SPI device, real or simulated."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

Transfer = tuple[bytes, int]
"""The bytes of one chip-select cycle, and the shortest pause after them in µs. In v1.0.0 nothing comes back."""
Batch = Sequence[Transfer]
"""Transfers that leave together. No other transfer, of any program, comes between them or into the last pause."""


class OpenDevice(Protocol):
    """An opened SPI device. No other program reaches it, unless a device documents otherwise."""

    def stop_servos_at_work(self) -> bool | None:
        """Return whether `stop-servos` uses the same device now (None: not known). Takes microseconds, never raises."""
        return False

    def put_right(self) -> str | None:
        """Restore settings that another program has changed. Return what was found, or None for no change.

        Takes microseconds, never raises.
        """
        return None

    def close(self) -> None:
        """Release the device. Never raises; closing twice is harmless."""
        return  # without this, mypy takes the method for an abstract one


class SpiDevice(OpenDevice, Protocol):
    """A device that writes batches; nothing comes back."""

    most_transfers: int = 32

    @abstractmethod
    def transfer(self, batch: Batch) -> None:
        """Write the batch and its pauses, in one call.

        Raises SpiError if the device reports a fault: any part of the batch may have been written. Raises
        BatchRejectedError if the device takes no batches: nothing was written.
        """


class DuplexDevice(OpenDevice, Protocol):
    """A device that makes single transfers, during which as many bytes come back."""

    @abstractmethod
    def exchange(self, data: bytes) -> bytes:
        """Write `data` and return the bytes that came back. Raises SpiError: any part may have been written."""
