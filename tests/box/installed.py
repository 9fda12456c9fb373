"""A robot's computer in a box: packages of several releases, all of the present code, and the gateway installed.

Its service runs under systemd, and the test receives every byte on SPI.
"""

import re
import shutil
from functools import cached_property
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile

import pytest

from gateway.model.frames import stop_leg
from release.build import build
from release.deb import deb, dependencies
from schemas.robot import LEGS
from tests.box.box import PATH_INSIDE, SHARED_INSIDE, Box, Unit
from tests.hil.bed import SpiTestbed, Transfer
from tests.support.child import Child
from tests.support.waiting import Closing

REPOSITORY = Path(__file__).parents[2]
NAME = "hexapod-gateway"
CONFIGURATION = f"/etc/{NAME}/gateway.toml"
PYTHON = (
    "/usr/bin/python3.11",
    "-ISc",
    f"import sys; sys.path.insert(0, '/usr/lib/{NAME}/current'); exec(sys.argv.pop(1))",
)
"""Runs the text that follows with what is installed."""
DROP_IN = f"/run/systemd/system/{NAME}.service.d"
STOPS = {stop_leg(leg).data for leg in LEGS}
WHEN = 1_700_000_000
LIBRARY = "/usr/lib/hexapod-gateway"
UNIT_FILE = "/usr/lib/systemd/system/hexapod-gateway.service"
LATE = "\nimport os, sys\nif 'run' in sys.argv and 'NOTIFY_SOCKET' in os.environ: raise SystemExit(7)\n"
"""A change by which a release starts in its trial and not under systemd."""
BROKEN = "\nimport sys\nif 'run' in sys.argv: raise SystemExit(7)\n"


class InstalledGateway(Closing):
    """An installed gateway whose SPI device is emulated outside the box, so that it outlives every process inside."""

    def __init__(self, box: Box) -> None:
        """`box` begins with the gateway installed."""
        self.box = box
        self.unit = Unit(box, f"{NAME}.service")
        self._configuration = box.read(CONFIGURATION)
        folder = box.shared / "bed"
        folder.mkdir()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("TMPDIR", str(folder))  # where the emulation puts its node and its socket
            self.bed = SpiTestbed()
        box.run("sh", "-c", "chgrp -R spi /box-out/bed && chmod -R g+rwX /box-out/bed")  # as udev would
        environment = self.bed.environment
        root = SHARED_INSIDE / Path(environment["UMOCKDEV_DIR"]).relative_to(box.shared)
        self.emulated = (f"LD_PRELOAD={environment['LD_PRELOAD']}", f"UMOCKDEV_DIR={root}")
        """The variables by which a program inside sees the device."""
        self.drop_in("emulated", f"Environment={' '.join(self.emulated)}\nReadWritePaths={root}")

    def close(self) -> None:
        self.bed.close()

    def drop_in(self, name: str, text: str) -> None:
        """Add these lines to the unit's [Service]."""
        self.box.write(f"{DROP_IN}/{name}.conf", f"[Service]\n{text}\n")
        self.box.run("systemctl", "daemon-reload")

    def configure(self, text: str) -> None:
        """Write the service's configuration: this, and the framing of the emulated device."""
        self.box.write(CONFIGURATION, f'spi.framing = "plain"\n{text}')

    def reset(self) -> None:
        """Stop the service; leave its own configuration, and no drop-in but the emulated device's."""
        self.bed.heal()
        self.bed.release()
        self.unit.systemctl("stop", check=False)
        self.unit.systemctl("reset-failed", check=False)
        self.box.write(CONFIGURATION, self._configuration)
        self.box.run("rm", "-f", f"/run/{NAME}/effective.json")  # as after a boot
        self.box.run("find", DROP_IN, "-type", "f", "!", "-name", "emulated.conf", "-delete")
        self.box.run("systemctl", "daemon-reload")

    def gateway(self, *arguments: str, check: bool = True) -> str:
        """Run a command of the installed gateway inside, and return what it printed on either stream."""
        done = self.box.run(NAME, *arguments, check=check)
        return done.stdout + done.stderr

    def cursor(self) -> str:
        """Return the journal's cursor after everything written until now."""
        self.box.run("journalctl", "--sync")
        return self.box.run("journalctl", "--show-cursor", "--lines=0").stdout.partition("-- cursor: ")[2].strip()

    def journal_since(self, cursor: str) -> str:
        """Return what the service, and systemd about it, has written since then."""
        self.box.run("journalctl", "--sync")
        return self.box.run("journalctl", *self._journal_options(cursor)).stdout

    def journal(self, unit: Unit | None = None) -> Child:
        """Return a unit's journal from now on, by default the service's, as a child whose lines can be waited for."""
        folder = next(path for path in ("var/log/journal", "run/log/journal") if self.box.exists(f"/{path}"))
        options = (f"--directory={self.box.root / folder}", *self._journal_options(self.cursor(), unit))
        return Child(["journalctl", "--follow", *options], {"PATH": "/usr/bin:/bin", "LANG": "C.UTF-8"})

    def _journal_options(self, cursor: str, unit: Unit | None = None) -> tuple[str, ...]:
        return f"--after-cursor={cursor}", "--no-pager", "--output=cat", f"--unit={(unit or self.unit).name}"


def wait_for_stops(bed: SpiTestbed, *, since: int = 0, opening: int | None = None) -> list[Transfer]:
    """Wait until each of the six legs got a Stop at transfer `since` or later; the transfers since then.

    Only those count that came from who opened the device as the `opening`th, if it is given.
    """

    def counted(seen: list[Transfer]) -> list[Transfer]:
        return [each for each in seen[since:] if opening in (None, each.opening)]

    return counted(bed.wait_for(lambda seen: {each.data for each in counted(seen) if each.delivered} >= STOPS, 30))


# ---- the package


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
