"""The emulated SPI device as a fixture; where its packages are missing, `hil` tests are skipped, but fail in CI."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.model.frames import Framing
from tests.hil.bed import SpiTestbed
from tests.hil.wire import Wire, start
from tests.support.gateway_process import Gateway


@pytest.fixture
def spi_testbed() -> Iterator[SpiTestbed]:
    """Yield a fresh emulated `/dev/spidev0.0`, which no load slows if allowed. Programs still running are killed."""
    with SpiTestbed() as bed:
        bed.prefer()
        yield bed


@pytest.fixture
def wire(request: pytest.FixtureRequest, spi_testbed: SpiTestbed) -> Wire:
    """Return the emulated device in the published firmware's framing; for tests marked `EACH_FRAMING`, in each."""
    return Wire(spi_testbed, getattr(request, "param", Framing.LENGTH_PREFIXED))


@pytest.fixture
def gateway(tmp_path: Path, wire: Wire) -> Iterator[Gateway]:
    with start(tmp_path, wire) as gateway:
        yield gateway
