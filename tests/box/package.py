"""Packages of several releases, all of the code as it is, and a robot in a box to install them on."""

import re
import shutil
from functools import cached_property
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile

from release.build import build
from release.deb import deb, dependencies
from tests.box.box import PATH_INSIDE, SHARED_INSIDE, Box
from tests.box.installed import CONFIGURATION, InstalledGateway, wait_for_stops

WHEN = 1_700_000_000
LIBRARY = "/usr/lib/hexapod-gateway"
UNIT_FILE = "/usr/lib/systemd/system/hexapod-gateway.service"
LATE = "\nimport os, sys\nif 'run' in sys.argv and 'NOTIFY_SOCKET' in os.environ: raise SystemExit(7)\n"
"""A change by which a release starts in its trial and not under systemd."""
BROKEN = "\nimport sys\nif 'run' in sys.argv: raise SystemExit(7)\n"


class Packages:
    """Made in `folder`, each once; without compression."""

    def __init__(self, folder: Path, architecture: str = "amd64") -> None:
        self._folder = folder
        self._architecture = architecture

    @cached_property
    def _wheel(self) -> Path:
        return build(self._folder, "1.1.0", WHEN)[0]

    @cached_property
    def _dependencies(self) -> Path:
        return dependencies(self._folder, self._architecture)

    def make(self, release: str, change: str = "") -> Path:
        """Return the package of `release`; its gateway/__init__.py also has `change`."""
        folder = self._folder / release
        if not folder.exists():
            folder.mkdir()
            wheel = folder / self._wheel.name
            with ZipFile(self._wheel) as plain, ZipFile(wheel, "w", ZIP_STORED) as changed:
                for name in plain.namelist():
                    text = change.encode() if name == "gateway/__init__.py" else b""
                    changed.writestr(name, plain.read(name) + text)
            deb(folder, wheel, self._dependencies, release, WHEN, self._architecture, pack="none")
        return next(folder.glob("*.deb"))


def install(box: Box, package: Path, *options: str, check: bool = True) -> str:
    """Install the package as apt does, and return what was printed. Recommended packages are left out: no network."""
    return dpkg(box, "dpkg", *options, "--install", share(box, package), check=check)


def share(box: Box, package: Path) -> str:
    """Put a package where the box sees it, and return its path inside."""
    if not (box.shared / package.name).exists():
        shutil.copy(package, box.shared)
    return f"{SHARED_INSIDE}/{package.name}"


def current(box: Box) -> str:
    """Return the name that the link leads to, or "" without a link."""
    return box.run("readlink", f"{LIBRARY}/current", check=False).stdout.strip()


def dpkg(box: Box, *command: str, check: bool = True) -> str:
    """Run a command of Debian's, and return what it printed. `check`: it must succeed."""
    done = box.run(*command, env={"DEBIAN_FRONTEND": "noninteractive", "PATH": PATH_INSIDE}, check=check, timeout_s=300)
    said = done.stdout + done.stderr
    assert check == (done.returncode == 0), said
    return said


CONFIG_TXT = "/boot/firmware/config.txt"
STOCK = "#dtparam=i2c_arm=on\n#dtparam=spi=on\n\ndtoverlay=vc4-kms-v3d\n[cm4]\notg_mode=1\n"
WITHOUT_UDEV = "#!/bin/sh\necho Failed to send reload request: No such file or directory >&2\nexit 1\n"
"""`udevadm` of a machine on which no udev runs, as in a box. Whether this machine has the package must not show."""


def prepare(box: Box, package: Path) -> str:
    """Install and set up a future Raspberry Pi, and return what `setup` printed. Its `check` finds no SPI device."""
    box.write(CONFIG_TXT, STOCK)
    box.write("/usr/local/sbin/udevadm", WITHOUT_UDEV)
    box.run("chmod", "+x", "/usr/local/sbin/udevadm")
    install(box, package)
    return box.run("hexapod-gateway", "setup", "--framing", "plain", check=False, timeout_s=120).stdout


def simulate(box: Box) -> None:
    """Start the service with the simulated controller instead of SPI, as simulated.conf does."""
    drop_in = "/etc/systemd/system/hexapod-gateway.service.d/simulated.conf"
    box.run("install", "-Dm644", "/usr/share/hexapod-gateway/simulated.conf", drop_in)
    box.run("systemctl", "daemon-reload")
    box.run("systemctl", "restart", "hexapod-gateway")


class Robot(InstalledGateway):
    """A robot with a package installed, its configuration written and its service enabled."""

    def __init__(self, box: Box) -> None:
        super().__init__(box)
        self.configure("")
        self.unit.systemctl("enable", check=False)

    def runs(self) -> str:
        """Return the release that the service's process has loaded, wherever it is stored now."""
        found = re.search(f"{LIBRARY}/([^/]+)/", self.box.read(f"/proc/{self.unit.property('MainPID')}/maps"))
        assert found is not None
        return found[1].removesuffix(".kept")

    def is_at_work(self, release: str) -> None:
        """Check that this release runs and moves a servo, and that its last means of stopping works."""
        assert self.runs() == release
        folder = self.box.read(f"/proc/{self.unit.property('MainPID')}/cmdline").split("\0")[2]
        assert self.box.exists(f"{folder}/gateway/__init__.py"), "what it has not yet imported is there"
        assert "accepted" in self.gateway("send", "leg", "3", "start", "90", "45", "120")
        self.gateway("send", "leg", "3", "stop")
        since = len(self.bed.transfers)
        self.box.run("env", *self.emulated, "hexapod-gateway", "stop-servos", "--config", CONFIGURATION)
        wait_for_stops(self.bed, since=since)


def hold(box: Box, *options: str) -> str:
    """Hold leg 3 from now on, by a process whose number is returned. `options`: of the command."""
    command = f"hexapod-gateway send leg 3 start 90 45 120 --hold 300 {' '.join(options)} >/dev/null 2>&1 & echo $!"
    held = box.run("sh", "-c", command).stdout.strip()
    box.run("sh", "-c", "until grep -q ' 1$' /run/hexapod-gateway/servos; do sleep 0.05; done")
    return held


def let_go(box: Box, held: str, *options: str) -> None:
    """End the process that holds the leg. Servos rest again, and nobody drives."""
    box.run("kill", held)
    box.run("hexapod-gateway", "stop", *options)
    box.run("sh", "-c", "until grep -q ' 0$' /run/hexapod-gateway/servos; do sleep 0.05; done")
    status = f"hexapod-gateway status {' '.join(options)}"
    box.run("sh", "-c", f"until {status} | grep -q '^Nobody drives'; do sleep 0.05; done")
