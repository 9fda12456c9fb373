"""What the service needs from an SPI device, real or simulated."""

from collections.abc import Sequence
from typing import Protocol

Transfer = tuple[bytes, int]
"""One chip-select cycle, and the least pause behind it, in µs; nothing comes back in v1.0.0."""
Batch = Sequence[Transfer]
"""Transfers that leave together: nothing of this or another program comes between them, or into the last pause."""


class SpiDevice(Protocol):
    """An opened SPI device, whose unit is the batch."""

    most_transfers: int
    """The longest batch that it takes."""

    def transfer(self, batch: Batch) -> None:
        """Write the batch, in one call that also takes its pauses.

        Raises `SpiError` when the device reports a fault: then nobody knows how far it came. Raises
        `BatchRejectedError` when it takes no batches: then nothing was written.
        """

    def fileno(self) -> int | None:
        """The file by whose record locks programs share the bus; None where no other program can reach the device."""

    def stop_servos_at_work(self) -> bool:
        """Whether `stop-servos` stops the servos through the same device now. Takes microseconds, never raises."""

    def close(self) -> None:
        """Release the device. Never raises; closing twice is harmless."""
