"""Boxes as fixtures, and the wheels that go into it; where no box can be, its tests are skipped, but fail in CI."""

import fcntl
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.box.box import Box
from tests.box.installed import NAME, InstalledGateway
from tests.box.last_release import LastRelease
from tests.box.machine import CONFIG_TXT, STOCK, Machine, Prepared
from tests.box.package import Packages
from tests.hil.bed import SYSTEM_PYTHON

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `make wheels` makes, for the system's Python; the one thing here that needs a network."""
    folder = tmp_path_factory.mktemp("wheels")
    with (tmp_path_factory.getbasetemp().parent / "wheels.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two of pip that build one wheel at once spoil each other's cache
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


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Packages:
    """Packages of several releases; what they need comes over the network, or from uv's cache."""
    return Packages(tmp_path_factory.mktemp("packages"))


@pytest.fixture(scope="session")
def prepared(tmp_path_factory: pytest.TempPathFactory, wheels: Path) -> Iterator[Prepared]:
    """A machine with the gateway installed from wheels, of which each box has a view of its own."""
    made = Prepared.by(tmp_path_factory.mktemp("prepared"), wheels)
    yield made
    made.layer.unlink(missing_ok=True)  # which is large


@pytest.fixture(scope="session")
def last_layer(tmp_path_factory: pytest.TempPathFactory, wheels: Path) -> Iterator[Path]:
    """A machine with the release before this one, of which each box has a view of its own."""
    folder = tmp_path_factory.mktemp("last")
    layer = folder / "layer.tar"
    LastRelease.by(folder, wheels.parent / "venv/bin/python").install(folder, layer)
    yield layer
    layer.unlink(missing_ok=True)


@contextmanager
def booted(folder: Path, wheels: Path, base: Path | None = None) -> Iterator[Machine]:
    with Box(folder, base=base) as box:
        yield Machine(box, wheels)
        print(box.run("journalctl", f"--unit={NAME}", "--lines=20", "--output=cat").stdout)


@pytest.fixture
def bare(tmp_path_factory: pytest.TempPathFactory, wheels: Path) -> Iterator[Machine]:
    """One with nothing in it but this machine's Debian."""
    with booted(tmp_path_factory.mktemp("bare"), wheels) as machine:
        machine.box.write(CONFIG_TXT, STOCK)
        yield machine


@pytest.fixture
def machine(tmp_path_factory: pytest.TempPathFactory, wheels: Path, prepared: Prepared) -> Iterator[Machine]:
    """One with the gateway installed, booted since, and its service not begun: there is no SPI device."""
    with booted(tmp_path_factory.mktemp("machine"), wheels, prepared.layer) as machine:
        yield machine


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, wheels: Path, prepared: Prepared) -> Iterator[InstalledGateway]:
    """A box with the gateway installed, and an emulated SPI device behind it; one for all tests of a file."""
    folder = tmp_path_factory.mktemp("installed")
    with Box(folder, base=prepared.layer) as box, InstalledGateway(box, wheels) as robot:
        yield robot


@pytest.fixture
def robot(installed: InstalledGateway) -> Iterator[InstalledGateway]:
    """The same, with the service stopped and the configuration as installed, before and after."""
    installed.reset()
    cursor = installed.cursor()
    yield installed
    print(installed.journal_since(cursor))  # pytest shows it where the test failed
    installed.reset()
