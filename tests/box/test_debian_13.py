"""The package on Debian 13, whose Python is another one: from `apt install` to a robot that moves."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.box.box import SHARED_INSIDE, Box
from tests.box.installed import NAME
from tests.box.package import LIBRARY, Packages, simulate

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

PARTS = "systemd,systemd-sysv,dbus,iproute2,python3,python3-spidev"


@pytest.fixture(scope="module")
def trixie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Debian 13 in a folder, from Debian's mirror."""
    if shutil.which("debootstrap") is None:
        pytest.skip("needs debootstrap: sudo apt-get install debootstrap")
    root = tmp_path_factory.mktemp("debian") / "13"
    command = ["debootstrap", "--variant=minbase", f"--include={PARTS}", "trixie", str(root)]
    made = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200)
    assert made.returncode == 0, made.stdout[-2000:] + made.stderr
    return root


def test_install_set_up_and_move(trixie: Path, tmp_path_factory: pytest.TempPathFactory, packages: Packages) -> None:
    with Box(tmp_path_factory.mktemp("box"), root=trixie) as box:
        package = packages.make("1.1.0")
        shutil.copy(package, box.shared)
        apt = ("apt-get", "install", "--yes", f"{SHARED_INSIDE}/{package.name}")
        said = box.run(*apt, env={"DEBIAN_FRONTEND": "noninteractive"}, timeout_s=300)
        assert "Next: sudo hexapod-gateway setup" in said.stdout + said.stderr
        assert "-313.pyc" in box.run("ls", f"{LIBRARY}/current/gateway/__pycache__").stdout, "compiled for this Python"
        box.run(NAME, "setup", "--framing", "plain", check=False, timeout_s=120)  # its `check` finds no SPI device
        simulate(box)
        assert "accepted" in box.run(NAME, "send", "leg", "3", "start", "90", "45", "120").stdout
        checked = box.run(NAME, "check", check=False).stdout
        assert "spidev is not installed" not in checked
        assert "not as installed" not in checked
        box.run("apt-get", "purge", "--yes", NAME, env={"DEBIAN_FRONTEND": "noninteractive"}, timeout_s=300)
        assert not box.exists(LIBRARY)
