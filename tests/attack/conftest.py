"""The emulated SPI device, for attacks that end at the wire."""

from tests.hil.conftest import spi_testbed

__all__ = ["spi_testbed"]
