"""Pages to the letter: docs/certificates.md on an installed robot, which is the machine with the CA, too; and README's
*On the robot*, pasted into a fresh Debian 12 and a fresh Debian 13, and answered as a person would.
"""

import shlex
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from tests.box.box import PATH_INSIDE, Box
from tests.box.installed import CONFIG_TXT, LIBRARY, NAME, STOCK, WITHOUT_UDEV, Packages, share, simulate
from tests.support.pages import SCP, SSH, SUDO, blocks, commands, section

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

FOLDER = "/root/hexapod-certs"
STATE = f"/var/lib/{NAME}"


@dataclass
class Scene:
    """A robot with certificates, and people with files of their own."""

    box: Box

    def follow(self, lines: Iterable[str]) -> str:
        """Run these lines in root's home, and return their output. A `check` may find that this machine has no SPI."""
        said, env = "", {"PATH": f"/root/bin:{PATH_INSIDE}", "HOSTS": "/root/hosts"}
        for line in lines:
            done = self.box.run("bash", "-c", f"cd && {line}", env=env, check=False, timeout_s=60)
            said += done.stdout + done.stderr
            assert done.returncode == 0 or f"{NAME} check" in line, f"{line}\n{said}"
        return said

    def may_stop(self, name: str, *wait: str) -> bool:
        """Return whether this laptop may command the robot."""
        config = ("--zenoh-config", f"/root/{name}/{name}.json5")
        done = self.box.run(NAME, "send", "leg", "3", "stop", *config, *wait, check=False)
        return "accepted" in done.stdout

    def lets_in(self, *names: str) -> bool:
        """Return whether these laptops and bert, who is never shut out, may command the robot, and no others."""
        present = all(self.may_stop(name, "--timeout", "20") for name in ("bert", *names))
        return present and not any(self.may_stop(name, "--timeout", "1") for name in {"anna", "lena"} - {*names})


@pytest.fixture(name="scene")
def make_scene(tmp_path: Path, prepared: Path) -> Iterator[Scene]:
    """Yield a box with the gateway installed, booted since, and without an SPI device."""
    with Box(tmp_path, base=prepared) as box:
        for name, text in {"ssh": SSH, "scp": SCP, "sudo": SUDO}.items():
            box.write(f"/root/bin/{name}", text)
        box.run("sh", "-c", "chmod +x /root/bin/* && mkdir -p /root/hosts/robot.local")
        box.run("sh", "-c", "echo 127.0.0.1 robot.local >>/etc/hosts")
        box.run(NAME, "certs", "init", "--dir", FOLDER, "--host", "robot.local")
        scene = Scene(box)
        for name in ("anna", "bert", "lena"):
            box.run(NAME, "certs", "issue", name, "--role", "operator", "--dir", FOLDER)
            box.run("sh", "-c", f"mkdir /root/{name} && cp {FOLDER}/{name}.* {FOLDER}/ca.pem /root/{name}")
        box.run(NAME, "setup", "--certs", FOLDER, check=False, timeout_s=60)  # its `check` finds no SPI device
        simulate(box)
        yield scene


def test_a_restored_backup_lets_nobody_in_once_the_page_is_followed_to_its_end(scene: Scene) -> None:
    box = scene.box
    assert scene.lets_in("anna", "lena")
    assert "there is no list: nobody is shut out" in box.run(NAME, "check", check=False).stdout
    (revoke,) = commands("certificates.md", "## A laptop is lost, or was stolen")
    scene.follow([revoke.replace("anna", "lena")])
    assert scene.lets_in("anna")
    keep, restore = commands("certificates.md", "## What to keep")[:2], commands("certificates.md", "**A new card")
    scene.follow(keep)
    assert "gateway: list 2 is in force." in scene.follow([revoke])
    assert scene.lets_in()

    *unpacked, delivered = restore
    box.run("sh", "-c", f"systemctl stop {NAME} && rm -rf {STATE}/* /etc/{NAME}/*")  # a new card
    assert " list 1 of " in scene.follow(unpacked)
    assert scene.lets_in("anna"), "what the page warns of"
    said = scene.follow([delivered])
    assert "gateway: list 2 is in force." in said
    assert scene.lets_in()


# ---- the README


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
