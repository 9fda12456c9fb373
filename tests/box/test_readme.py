"""README's *On the robot*, pasted into a fresh Debian 12 and a fresh Debian 13, and answered as a person would."""

import shlex
import subprocess
from pathlib import Path
from typing import Final

import pytest

from tests.box.box import PATH_INSIDE, Box
from tests.box.installed import NAME
from tests.box.package import CONFIG_TXT, LIBRARY, STOCK, WITHOUT_UDEV, Packages, share, simulate
from tests.support.pages import SUDO, blocks, section

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

README: Final = Path(__file__).parents[2] / "README.md"
PARTS: Final = "systemd,systemd-sysv,dbus,iproute2,python3,python3-spidev"
ANSWERS: Final = ("y\n", "hexapod-1.0\nplain\n", "61\n90\nyes\nyes\nyes\n")
"""To apt, to setup (wire, framing), and to check (which servo, from where, to move it, it moved, it is loose)."""


def debian(suite: str, root: Path, parts: str = PARTS) -> Path:
    """Return a Debian in a folder, from Debian's mirror; with the spidev that Raspberry Pi OS has."""
    command = ["debootstrap", "--variant=minbase", f"--include={parts}", suite, str(root)]
    made = subprocess.run(command, capture_output=True, text=True, check=False, timeout=1200)
    assert made.returncode == 0, made.stdout[-2000:] + made.stderr
    return root


def paste(box: Box, command: str, answers: str, *, check: bool = True) -> str:
    """Type a command and its answers at a terminal in the box, and return what it printed."""
    typed = f"cd && printf %s {shlex.quote(answers)} | script -qefc {shlex.quote(command)} /dev/null"
    return box.run("sh", "-c", typed, env={"PATH": PATH_INSIDE}, check=check, timeout_s=300).stdout


@pytest.mark.parametrize(("suite", "compiled"), [("bookworm", "-311.pyc"), ("trixie", "-313.pyc")])
def test_readmes_four_commands_lead_from_nothing_to_a_servo_that_moves(
    suite: str, compiled: str, tmp_path_factory: pytest.TempPathFactory, packages: Packages
) -> None:
    root = debian(suite, tmp_path_factory.mktemp("debian") / suite)
    with Box(tmp_path_factory.mktemp("box"), root=root) as box:
        for path, text in {"/usr/local/bin/sudo": SUDO, "/usr/local/sbin/udevadm": WITHOUT_UDEV}.items():
            box.write(path, text)
            box.run("chmod", "+x", path)
        box.write(CONFIG_TXT, STOCK)
        (block,) = blocks(section(README.read_text(encoding="utf-8"), "## On the robot"), "console")
        copy, install, setup, first_contact = (
            line.removeprefix("$ ").partition(" #")[0].rstrip() for line in block.splitlines()
        )
        assert copy.startswith("scp hexapod-gateway_*_arm64.deb ")  # here: by a shared folder, and under this name
        box.run("cp", share(box, packages.make("1.1.0")), "/root/hexapod-gateway_1.1.0_arm64.deb")
        assert "Next: sudo hexapod-gateway setup" in paste(box, install, ANSWERS[0])
        assert compiled in box.run("ls", f"{LIBRARY}/current/gateway/__pycache__").stdout
        said = paste(box, setup, ANSWERS[1], check=False)
        assert "Traceback" not in said
        assert "Next: sudo reboot; then: sudo hexapod-gateway check" in said  # SPI was off, as in Raspberry Pi OS
        simulate(box)  # in place of the reboot and of a controller
        said = paste(box, first_contact, ANSWERS[2])
        assert "Then everything from here to servo 61 works." in said
        checked = box.run(NAME, "check", check=False).stdout
        assert "not as installed" not in checked
        box.run("apt-get", "purge", "--yes", NAME, env={"DEBIAN_FRONTEND": "noninteractive"}, timeout_s=300)
        assert not box.exists(LIBRARY)
