"""What the service needs from an SPI device, real or simulated."""

from contextlib import AbstractContextManager
from typing import Protocol


class SpiDevice(Protocol):
    """An opened SPI device: one `transfer` is one chip-select cycle, and nothing comes back in v1.0.0."""

    def transfer(self, data: bytes) -> None:
        """Write `data` in one transaction. Raises `SpiError` when the device reports a fault."""

    def lock(self) -> AbstractContextManager[None]:
        """The bus lock, held for one frame: no other program's transfers come between those of the frame."""

    def stop_servos_at_work(self) -> bool:
        """Whether `stop-servos` stops the servos through the same device now. Takes microseconds, never raises."""

    def close(self) -> None:
        """Release the device. Never raises; closing twice is harmless."""
