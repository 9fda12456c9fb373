"""Somebody pulls the plug after install.sh has finished, as it asks for itself to get SPI: the robot comes up.

HEXAPOD_POWER_CUTS=30 cuts at thirty moments, a second apart, as long as the kernel may keep in memory what was written.
"""

import os
import time
from pathlib import Path

import pytest

from tests.box.box import Box
from tests.box.disk import Disk
from tests.box.installed import CONFIGURATION, NAME
from tests.box.machine import Machine

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

MOMENTS = int(os.environ.get("HEXAPOD_POWER_CUTS", "2"))
FILES = f"find /opt/{NAME} /etc/{NAME} /etc/systemd/system -type f -print0 | sort -z | xargs -0 sha256sum | sha256sum"


def test_the_plug_is_pulled(tmp_path: Path, wheels: Path) -> None:
    disk = Disk.new(tmp_path / "disk")
    with Box(folder(tmp_path, "first"), disk=disk.image) as box:
        Machine(box, wheels).install()
        end_s = time.monotonic()
        cuts = [disk.cut(tmp_path / "cut-0")]
        installed = box.run("sh", "-c", FILES).stdout
        written = disk.writes()
        for moment in range(1, MOMENTS):
            time.sleep(max(0.0, end_s + moment - time.monotonic()))  # a moment, and not a wait for anything
            if disk.writes() != written:  # else the disk is as at the moment before
                written = disk.writes()
                cuts.append(disk.cut(tmp_path / f"cut-{moment}"))
    print(f"{len(cuts)} different disks at {MOMENTS} moments")
    for cut in cuts:
        with Box(folder(tmp_path, f"after-{cut.image.name}"), disk=cut.image) as box:
            assert box.run("sh", "-c", FILES).stdout == installed, cut.image.name
            machine = Machine(box, wheels)
            assert machine.unit.property("UnitFileState") == "enabled"
            machine.simulate()
            assert "accepted" in machine.send()
            assert 'framing = "plain"' in box.read(CONFIGURATION).splitlines()
        cut.image.unlink()


def folder(parent: Path, name: str) -> Path:
    (parent / name).mkdir()
    return parent / name
