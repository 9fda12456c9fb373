"""docs/certificates.md to the letter, on an installed robot, which is the machine with the CA, too."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.box.box import PATH_INSIDE, Box
from tests.box.installed import NAME
from tests.box.package import simulate
from tests.support.pages import SCP, SSH, SUDO, commands

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
