"""The plug is pulled while dpkg works: the old or the new release runs after the next boot, and dpkg finishes.

A cut is a copy of the disk while everything in the box is frozen: it has what had reached the disk by then, though the
kernel goes on writing. dpkg flushes its files, as on a Pi; container images switch that off. `make test-all` cuts an
upgrade at two instants, `make nightly` at ten more inside dpkg's work.
"""

import subprocess
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import pytest

from tests.box.box import PATH_INSIDE, Box
from tests.box.installed import CONFIGURATION, LIBRARY, NAME, Packages, Robot, dpkg, install, prepare, share, simulate
from tests.support.child import Child

pytestmark = pytest.mark.systemd

SIZE = "2G"  # sparse; an installation takes some 200 MB
ROOM = "16G"  # sparse; copies share what they have in common
LIFE_S = 3600
FIRST, SECOND = (0.05, 0.3, 0.6, 0.8, 0.95), (1.05, 1.3, 1.6, 1.8, 1.95)
"""Instants of dpkg's work: while it writes files under names of its own, and while it gives them theirs."""
FLUSHING = "grep -l unsafe-io /etc/dpkg/dpkg.cfg.d/* | xargs rm -f"
SLOW_WATCHDOG = "[Service]\nWatchdogSec=0\n"
"""While it is frozen the service is not late."""


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Yield a folder for disks that are cut. Its name is short, since a socket's has 107 bytes at most.

    XFS copies a whole file at one instant, also during a write: the copy contains each write, or lacks it.
    """
    found = tmp_path_factory.mktemp("cut")
    room = found.with_name(f"{found.name}.xfs")
    subprocess.run(["truncate", f"--size={ROOM}", str(room)], check=True)
    subprocess.run(["mkfs.xfs", "-q", "-m", "reflink=1", str(room)], check=True)
    subprocess.run(["mount", "-o", "loop", str(room), str(found)], check=True)
    try:
        yield found
    finally:
        subprocess.run(["umount", "--lazy", str(found)], check=True)
        room.unlink()


def sub(parent: Path, name: str) -> Path:
    (parent / name).mkdir()
    return parent / name


def cut(box: Box, disk: Path, copy: Path) -> Path:
    """Return what would be on the disk if the power failed now. Nothing in the box runs meanwhile, not even systemd."""
    freeze = box.root / "sys/fs/cgroup/cgroup.freeze"
    freeze.write_text("1")
    try:
        subprocess.run(["cp", "--reflink=always", str(disk), str(copy)], check=True)
    finally:
        freeze.write_text("0")
    return copy


def instants(box: Box, package: Path, shares: Sequence[float]) -> Iterator[Callable[[], bool]]:
    """Yield how far dpkg is with a package, by its files in the order in which dpkg takes them.

    0 … 1: so much is written, under dpkg's own names. 1 … 2: so much has got its name.
    """
    command = ["dpkg-deb", "--contents", str(package)]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    names = [line.split()[5] for line in listed]
    files = [box.root / name for name in names if LIBRARY in name and not name.endswith("/")]
    for each in shares:
        file = files[int(each % 1 * (len(files) - 1))]
        forms = [file] if each > 1 else [file, file.with_name(f"{file.name}.dpkg-new")]
        yield partial(lambda forms: any(form.exists() for form in forms), forms)


def comes_up(disk: Path, folder: Path, packages: Packages) -> str:
    """Boot from what was on the disk, and return which release runs. dpkg then finishes."""
    with Box(folder, disk=disk) as box:
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
    disk.unlink()
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
    """The kernel initialises nothing in the background on the disk, as on a card in use."""
    disk, cuts = folder / "disk", list[Path]()
    options = "lazy_itable_init=0,lazy_journal_init=0"
    subprocess.run(["mkfs.ext4", "-q", "-E", options, str(disk), SIZE], check=True, capture_output=True)
    with Box(sub(folder, "first"), disk=disk, life_s=LIFE_S) as box:
        box.run("sh", "-c", FLUSHING)
        prepare(box, packages.make("1.1.0"))
        box.write(f"/etc/systemd/system/{NAME}.service.d/watchdog.conf", SLOW_WATCHDOG)
        simulate(box)
        box.run("sync")
        package = packages.make("1.1.1")
        command = box.command("dpkg", "--install", share(box, package))
        reached = list(instants(box, package, shares))
        with Child(command, {"PATH": PATH_INSIDE, "LANG": "C.UTF-8"}) as child:
            for number, is_reached in enumerate(reached):
                while child.returncode is None and not is_reached():
                    pass  # an instant may last some milliseconds
                cuts.append(cut(box, disk, folder / f"cut-{number}"))
            assert child.wait(120) == 0, child
    ran = [comes_up(each, sub(folder, f"after-{each.name}"), packages) for each in cuts]
    assert set(ran) == {"1.1.0"}, "nothing has switched yet"
