"""The box as a fixture, and the wheels that go into it; where no box can be, its tests are skipped, but fail in CI."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.box.box import Box, lacks
from tests.box.installed import InstalledGateway
from tests.hil.bed import SYSTEM_PYTHON, missing_packages

REPOSITORY = Path(__file__).parents[2]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip or fail in one line that says why."""
    if item.get_closest_marker("systemd") and (lack := lacks() or missing_packages()):
        if os.environ.get("CI") == "true":
            pytest.fail(lack, pytrace=False)
        pytest.skip(lack)


@pytest.fixture(scope="session")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `make wheels` makes, for the system's Python; the one thing here that needs a network."""
    folder = tmp_path_factory.mktemp("wheels")
    made = subprocess.run(
        ["make", "wheels", f"PYTHON={SYSTEM_PYTHON}", f"VENV={folder / 'venv'}", f"WHEELS={folder / 'wheels'}"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert made.returncode == 0, made.stdout + made.stderr
    return folder / "wheels"


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Box]:
    """A box with nothing in it but this machine's Debian; one for all tests of a file."""
    with Box(tmp_path_factory.mktemp("box")) as box:
        yield box


@pytest.fixture(scope="session")
def installed(tmp_path_factory: pytest.TempPathFactory, wheels: Path) -> Iterator[InstalledGateway]:
    """A box with the gateway installed from wheels, and an emulated SPI device behind it; one for several files.

    The last of them, test_systemd_console.py, takes the installation away.
    """
    with Box(tmp_path_factory.mktemp("installed")) as box, InstalledGateway(box, wheels) as robot:
        yield robot


@pytest.fixture
def robot(installed: InstalledGateway) -> Iterator[InstalledGateway]:
    """The same, with the service stopped and the configuration as installed, before and after."""
    installed.reset()
    cursor = installed.cursor()
    yield installed
    print(installed.journal_since(cursor))  # pytest shows it where the test failed
    installed.reset()
