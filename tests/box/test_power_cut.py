"""The plug is pulled while dpkg works: the old or the new release runs after the next boot, and dpkg finishes.

A cut is a copy of the disk while everything in the box is frozen: it has what had reached the disk by then, though the
kernel goes on writing. dpkg flushes its files, as on a Pi; container images switch that off. `make test-all` cuts an
upgrade at two instants, `make nightly` at ten more inside dpkg's work.
"""

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import pytest

from tests.box.box import PATH_INSIDE, Box
from tests.box.installed import CONFIGURATION, NAME
from tests.box.package import LIBRARY, Packages, Robot, dpkg, install, prepare, share, simulate
from tests.support.child import Child

pytestmark = pytest.mark.systemd

SIZE = "2G"  # sparse; an installation takes some 200 MB
ROOM = "16G"  # sparse; copies share what they have in common


@contextmanager
def copies_at_once(folder: Path) -> Iterator[Path]:
    """A folder in which disks can be cut. What lies there is gone afterwards.

    XFS copies a file as it is at one moment, also during a write: each write is in the copy, or is missing.
    """
    room = folder.with_name(f"{folder.name}.xfs")
    subprocess.run(["truncate", f"--size={ROOM}", str(room)], check=True)
    subprocess.run(["mkfs.xfs", "-q", "-m", "reflink=1", str(room)], check=True)
    subprocess.run(["mount", "-o", "loop", str(room), str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
        room.unlink()


class Disk:
    """An ext4 image that a box runs from: its file has what the kernel has given to the disk, and no more."""

    def __init__(self, image: Path) -> None:
        self.image = image

    @classmethod
    def new(cls, image: Path) -> Self:
        """An empty one. Nothing is left for the kernel to initialise in the background, as on a card in use."""
        options = "lazy_itable_init=0,lazy_journal_init=0"
        subprocess.run(["mkfs.ext4", "-q", "-E", options, str(image), SIZE], check=True, capture_output=True)
        return cls(image)

    def cut(self, copy: Path) -> "Disk":
        """What would be on the disk if the power failed now."""
        subprocess.run(["cp", "--reflink=always", str(self.image), str(copy)], check=True)
        return Disk(copy)


LIFE_S = 3600
FIRST, SECOND = (0.05, 0.3, 0.6, 0.8, 0.95), (1.05, 1.3, 1.6, 1.8, 1.95)
"""Instants of dpkg's work: while it writes files under names of its own, and while it gives them theirs."""
FLUSHING = "grep -l unsafe-io /etc/dpkg/dpkg.cfg.d/* | xargs rm -f"
SLOW_WATCHDOG = "[Service]\nWatchdogSec=0\n"
"""While it is frozen the service is not late."""
Reached = Callable[[], bool]


@pytest.fixture(name="folder")
def make_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """With a short name: a socket's has 107 bytes at most."""
    with copies_at_once(tmp_path_factory.mktemp("cut")) as folder:
        yield folder


@contextmanager
def cuttable(folder: Path, packages: Packages) -> Iterator[tuple[Box, Disk]]:
    """A robot whose power can be cut. Release 1.1.0 runs there."""
    disk = Disk.new(folder / "disk")
    with Box(sub(folder, "first"), disk=disk.image, life_s=LIFE_S) as box:
        box.run("sh", "-c", FLUSHING)
        prepare(box, packages.make("1.1.0"))
        box.write(f"/etc/systemd/system/{NAME}.service.d/watchdog.conf", SLOW_WATCHDOG)
        simulate(box)
        box.run("sync")
        yield box, disk


def sub(parent: Path, name: str) -> Path:
    (parent / name).mkdir()
    return parent / name


def cut_while(box: Box, disk: Disk, command: Sequence[str], instants: Sequence[Reached], to: Path) -> list[Disk]:
    """Run a command inside, and cut the power at each of these instants; the command then goes on as if nothing was."""
    made: list[Disk] = []
    with Child(box.command(*command), {"PATH": PATH_INSIDE, "LANG": "C.UTF-8"}) as child:
        for number, reached in enumerate(instants):
            while child.returncode is None and not reached():
                pass  # an instant may last some milliseconds
            with frozen(box):
                made.append(disk.cut(to / f"cut-{number}"))
        assert child.wait(120) == 0, child
    return made


@contextmanager
def frozen(box: Box) -> Iterator[None]:
    """Nothing in the box runs meanwhile, systemd included."""
    freeze = box.root / "sys/fs/cgroup/cgroup.freeze"
    freeze.write_text("1")
    try:
        yield
    finally:
        freeze.write_text("0")


class Progress:
    """How far dpkg is with a package, by its files in the order in which dpkg takes them."""

    def __init__(self, box: Box, package: Path) -> None:
        command = ["dpkg-deb", "--contents", str(package)]
        listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        names = [line.split()[5] for line in listed]
        self._files = [box.root / name for name in names if LIBRARY in name and not name.endswith("/")]

    def at(self, share: float) -> Reached:
        """0 … 1: so much is written, under dpkg's own names. 1 … 2: so much has got its name."""
        file = self._files[int(share % 1 * (len(self._files) - 1))]
        written = file.with_name(f"{file.name}.dpkg-new")
        return file.exists if share > 1 else (lambda: written.exists() or file.exists())


def comes_up(cut: Disk, folder: Path, packages: Packages) -> str:
    """Boot from what was on the disk: one of both releases runs; dpkg then finishes. Returns which one ran."""
    with Box(folder, disk=cut.image) as box:
        assert 'framing = "plain"' in box.read(CONFIGURATION)
        with Robot(box) as robot:
            robot.unit.systemctl("start")
            ran = robot.runs()
            robot.is_at_work(ran)
            box.run("dpkg", "--configure", "-a", check=False, timeout_s=120)
            robot.is_at_work(robot.runs())
            install(box, packages.make("1.1.1"))
            robot.is_at_work("1.1.1")
            assert dpkg(box, "dpkg", "--audit") == ""
    cut.image.unlink()
    return ran


@pytest.mark.parametrize(
    "shares",
    [
        (0.6, 1.5),
        pytest.param(FIRST, marks=pytest.mark.nightly),
        pytest.param(SECOND, marks=pytest.mark.nightly),
    ],
    ids=["two", "first half", "second half"],
)
def test_an_upgrade_is_cut_while_dpkg_unpacks(folder: Path, packages: Packages, shares: Sequence[float]) -> None:
    with cuttable(folder, packages) as (box, disk):
        package = packages.make("1.1.1")
        progress = Progress(box, package)
        command = ("dpkg", "--install", share(box, package))
        cuts = cut_while(box, disk, command, [progress.at(each) for each in shares], folder)
    ran = [comes_up(cut, sub(folder, f"after-{cut.image.name}"), packages) for cut in cuts]
    assert set(ran) == {"1.1.0"}, "nothing has switched yet"
