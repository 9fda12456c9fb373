"""The emulated SPI device, for attacks that end at the wire; without its packages these are skipped."""

from tests.hil.conftest import pytest_runtest_setup, spi_testbed

__all__ = ["pytest_runtest_setup", "spi_testbed"]
