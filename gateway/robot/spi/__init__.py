"""What the service needs from an SPI device, real or simulated."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

Transfer = tuple[bytes, int]
"""One chip-select cycle, and the least pause behind its bytes, in µs; nothing comes back in v1.0.0."""
Batch = Sequence[Transfer]
"""Transfers that leave together: nothing of this or another program comes between them, or into the last pause."""


class OpenDevice(Protocol):
    """An opened SPI device. No other program reaches it, unless a device documents otherwise."""

    def stop_servos_at_work(self) -> bool | None:
        """Whether `stop-servos` stops the servos through the same device now; None: not known.

        Takes microseconds, never raises.
        """
        return False

    def put_right(self) -> str | None:
        """Set again what another program has changed on the device, and return what was found; None: nothing.

        Takes microseconds, never raises.
        """
        return None

    def close(self) -> None:
        """Release the device. Never raises; closing twice is harmless."""
        return  # without it, mypy takes the method for an abstract one


class SpiDevice(OpenDevice, Protocol):
    """One whose unit is the batch; nothing comes back."""

    most_transfers: int = 32
    """The longest batch that it takes."""

    @abstractmethod
    def transfer(self, batch: Batch) -> None:
        """Write the batch, in one call that also takes its pauses.

        Raises `SpiError` when the device reports a fault: then nobody knows how far it came. Raises
        `BatchRejectedError` when it takes no batches: then nothing was written.
        """


class DuplexDevice(OpenDevice, Protocol):
    """One whose unit is a single transfer, during which as many bytes come back."""

    @abstractmethod
    def exchange(self, data: bytes) -> bytes:
        """One transfer. Raises SpiError: then nobody knows how far it came."""


class ByteDevice(SpiDevice):
    """One that takes a batch transfer by transfer, without its pauses."""

    def transfer(self, batch: Batch) -> None:
        for data, _ in batch:
            self.take(data)

    @abstractmethod
    def take(self, data: bytes) -> None:
        """One transfer of a batch. Raises SpiError: then the rest of the batch does not come."""
