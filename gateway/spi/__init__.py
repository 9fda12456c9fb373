"""The device contract: what the service needs from an SPI device, whichever one stands behind it."""

from typing import Protocol


class SpiDevice(Protocol):
    """An opened SPI device: one `transfer` is one chip-select cycle, and nothing comes back in v1.0.0."""

    def transfer(self, data: bytes) -> None:
        """Write `data` in one transaction. Raises `SpiError` when the device reports a fault."""

    def close(self) -> None:
        """Release the device. Never raises; closing twice is harmless."""
