"""Somebody pulls the plug after install.sh has finished, as it asks for itself to get SPI: the robot comes up.

HEXAPOD_POWER_CUTS=30 cuts at thirty moments, a second apart, as long as the kernel may keep in memory what was written.
"""

import os
import time
from pathlib import Path

import pytest

from tests.box.box import Box, Unit
from tests.box.disk import Disk
from tests.box.installed import CONFIGURATION, INSTALLER, NAME, share

pytestmark = pytest.mark.systemd

MOMENTS = int(os.environ.get("HEXAPOD_POWER_CUTS", "2"))
FILES = f"find /opt/{NAME} /etc/{NAME} /etc/systemd/system -type f -print0 | sort -z | xargs -0 sha256sum | sha256sum"
SIMULATED = f"/run/systemd/system/{NAME}.service.d/simulated.conf"


def test_the_plug_is_pulled(tmp_path: Path, wheels: Path) -> None:
    disk = Disk.new(tmp_path / "disk")
    with Box(folder(tmp_path, "first"), disk=disk.image) as box:
        box.run(INSTALLER, "--framing", "plain", "--wheels", share(box, wheels), timeout_s=300)
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
            start_simulated(box)
        cut.image.unlink()


def folder(parent: Path, name: str) -> Path:
    (parent / name).mkdir()
    return parent / name


def start_simulated(box: Box) -> None:
    """The service that is enabled starts, from the configuration that is there, and takes a command."""
    unit = Unit(box, f"{NAME}.service")
    assert unit.property("UnitFileState") == "enabled"
    box.write(SIMULATED, "[Service]\nEnvironment=GATEWAY_OPTIONS=--sim\n")
    box.run("systemctl", "daemon-reload")
    unit.systemctl("restart")
    assert "accepted" in box.run(NAME, "send", "leg", "3", "start", "90", "45", "120").stdout
    assert 'framing = "plain"' in box.read(CONFIGURATION).splitlines()
