"""Boxes as fixtures, and the packages that go into them; where no box can be, its tests are skipped, but fail in CI."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.box.box import Box
from tests.box.installed import InstalledGateway, Packages, prepare


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Packages:
    """Return packages of several releases. What they need comes over the network, or from uv's cache."""
    return Packages(tmp_path_factory.mktemp("packages"))


@pytest.fixture(scope="session")
def prepared(tmp_path_factory: pytest.TempPathFactory, packages: Packages) -> Iterator[Path]:
    """Yield a machine with the package installed and set up, of which each box has a view of its own."""
    folder = tmp_path_factory.mktemp("prepared")
    layer = folder / "layer.tar"
    with Box(folder, keep=layer) as box:
        prepare(box, packages.make("1.1.0"))
    yield layer
    layer.unlink(missing_ok=True)  # which is large


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, prepared: Path) -> Iterator[InstalledGateway]:
    """Yield a box with the gateway installed, and an emulated SPI device behind it; one for all tests of a file."""
    with Box(tmp_path_factory.mktemp("installed"), base=prepared) as box, InstalledGateway(box) as robot:
        yield robot


@pytest.fixture
def robot(installed: InstalledGateway) -> Iterator[InstalledGateway]:
    """Yield the installed box, with the service stopped and the configuration as installed, before and after."""
    installed.reset()
    cursor = installed.cursor()
    yield installed
    print(installed.journal_since(cursor))  # pytest shows it where the test failed
    installed.reset()
