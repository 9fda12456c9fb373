"""A Raspberry Pi to be, as the installer finds it, and one on which it has been."""

import re
from pathlib import Path
from typing import NamedTuple

from tests.box.box import SHARED_INSIDE, Box, Unit
from tests.box.installed import INSTALLER, NAME, share

CONFIG_TXT = "/boot/firmware/config.txt"
STOCK = "#dtparam=i2c_arm=on\n#dtparam=spi=on\n\ndtoverlay=vc4-kms-v3d\n[cm4]\notg_mode=1\n"
DROP_IN = f"/etc/systemd/system/{NAME}.service.d/simulated.conf"
DRY = ("--dry-run", "--force")
WITHOUT_UDEV = "#!/bin/sh\necho Failed to send reload request: No such file or directory >&2\nexit 1\n"
"""`udevadm` of a machine on which no udev runs, as in a box. Whether this machine has the package must not show."""
_BUILD = f"""
set -e
kept=$(readlink -e /opt/{NAME}/venv)
cp -a "$kept" "$1"
find "$1/bin" -type f -exec sed -i "1s|^#!$kept/|#!$1/|" {{}} +
init=$(echo "$1"/lib/python*/site-packages/gateway/__init__.py)
printf '%s' "$2" >>"$init"
"$1/bin/python" -m compileall -q "$init"
cd "$1"
rm -f complete again unit
list=$(find . -type f -print0 | sort -z | xargs -0 sha256sum)
printf '%s\n' "$list" >complete
"""
"""What pip would make of another release's wheels, in the folder $1: its `gateway` has $2 besides."""


class Machine:
    """A Raspberry Pi to be, as the installer finds it."""

    def __init__(self, box: Box, wheels: Path) -> None:
        self.box = box
        self.unit = Unit(box, f"{NAME}.service")
        self.wheels = share(box, wheels)

    def install(self, *options: str, check: bool = True, python: str | None = None) -> list[str]:
        """Run the installer from the wheels, with a framing; the lines that it printed."""
        return self.run("--framing", "plain", "--wheels", self.wheels, *options, check=check, python=python)

    def run(self, *options: str, check: bool = True, python: str | None = None) -> list[str]:
        """Run the installer; the lines that it printed."""
        env = {"PYTHON": python} if python else {}
        done = self.box.run(INSTALLER, *options, check=check, env=env, timeout_s=300)
        assert check or done.returncode != 0, done.stdout
        return (done.stdout + done.stderr).splitlines()

    def release(self, name: str, change: str) -> str:
        """The wheels of another release, which is installed but for the switch; its `gateway` has `change` besides."""
        folder = f"/opt/{name}"
        self.box.run("sh", "-c", f"cp -r {self.wheels} {folder} && echo '# {name}' >>{folder}/requirements.txt")
        said = "\n".join(self.run(*DRY, "--wheels", folder))
        (venv,) = re.findall(f"^make (/opt/{NAME}/venv-[0-9a-f]+) ", said, re.MULTILINE)
        self.box.run("sh", "-c", _BUILD, "sh", venv, change)
        return folder

    def simulate(self) -> None:
        """The service begins, with the simulated controller in place of SPI, as deploy/systemd/simulated.conf says."""
        self.box.run("install", "-Dm644", f"{SHARED_INSIDE}/deploy/systemd/simulated.conf", DROP_IN)
        self.box.run("systemctl", "daemon-reload")
        self.unit.systemctl("start")

    def send(self) -> str:
        """Move leg 3 by the installed command; what it says of that."""
        return self.box.run(NAME, "send", "leg", "3", "start", "90", "45", "120").stdout

    def venv(self) -> str:
        """The folder that the service runs from."""
        return self.box.run("readlink", f"/opt/{NAME}/venv").stdout.strip()

    def traces(self) -> list[str]:
        """What of an installation is there."""
        paths = [f"/opt/{NAME}", f"/etc/{NAME}", f"/etc/systemd/system/{NAME}.service", f"/usr/local/bin/{NAME}"]
        paths.append(f"/etc/udev/rules.d/60-{NAME}.rules")
        found = [path for path in paths if self.box.exists(path)]
        users = [kind for kind in ("passwd", "group") if self.box.run("getent", kind, NAME, check=False).stdout]
        return found + users


class Prepared(NamedTuple):
    """What the installer leaves on a bare machine, and how it came there."""

    layer: Path
    """A base of boxes."""
    promised: list[str]
    """What its dry run said."""
    before: tuple[list[str], str]
    """What was there of an installation after that, and config.txt."""
    said: list[str]

    @classmethod
    def by(cls, folder: Path, wheels: Path) -> "Prepared":
        """Install once, for all boxes that begin with an installed gateway."""
        layer = folder / "layer.tar"
        with Box(folder, keep=layer) as box:
            machine = Machine(box, wheels)
            box.write(CONFIG_TXT, STOCK)
            box.write("/usr/local/sbin/udevadm", WITHOUT_UDEV)
            box.run("chmod", "+x", "/usr/local/sbin/udevadm")
            promised = machine.install("--dry-run")
            before = machine.traces(), box.read(CONFIG_TXT)
            said = machine.install()
        return cls(layer, promised, before, said)
