"""The release that robots have now: made as it was made then, installed by its own installer, and this one over it."""

import os
import re
import shutil
import subprocess
import tarfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.box.box import PATH_INSIDE, SHARED_INSIDE, Box
from tests.box.installed import INSTALLER, NAME, REPOSITORY, share
from tests.box.machine import CONFIG_TXT, STOCK, Machine

COMMIT = "4aa0d07"
"""The last that was landed on robots. It keeps no file of whether a servo runs, and had its rooms under other names."""
POINTS = "/run/points"
PLACES = int(os.environ.get("HEXAPOD_KILLS", "2"))
"""At so many of an upgrade's changes it is killed, and the plug is pulled."""
_UNTIL_A_SERVO_RUNS = """
from gateway.client import Client
with Client() as robot:
    while not any(servo.running for leg in robot.state().legs for servo in leg.servos):
        pass
"""
_COUNTED = f"""#!/bin/sh
PATH={PATH_INSIDE}
name=$(basename "$0")
case $name-$1 in systemctl-daemon-reload | systemctl-enable | systemctl-restart | systemctl-start) ;;
systemctl-*) exec systemctl "$@" ;;
esac
count=$(($(cat {POINTS}/count) + 1))
echo $count >{POINTS}/count
if [ $count = "$(cat {POINTS}/kill)" ]; then
	kill -KILL $PPID
	exit 1
fi
case " $(cat {POINTS}/wait) " in *" $count "*)
	echo $count >{SHARED_INSIDE}/point
	read -r _ <{SHARED_INSIDE}/go ;;
esac
exec "$name" "$@"
"""
_COMMANDS = "ln mv sync install cp chown rm setpriv systemctl"
"""Those by which the installer changes something."""
_MAKE = f"""
mkdir -p {POINTS}/bin
for name in {_COMMANDS}; do ln -sf {POINTS}/counted {POINTS}/bin/$name; done
chmod +x {POINTS}/counted
"""


class LastRelease(NamedTuple):
    """What was made of that commit."""

    sources: Path
    wheels: Path

    @classmethod
    def by(cls, folder: Path, python: Path) -> "LastRelease":
        """Its wheels, by its own script, with a Python that has pip."""
        sources, wheels = folder / "last-sources", folder / "last-wheels"
        archive = folder / "sources.tar"
        subprocess.run(["git", "-C", str(REPOSITORY), "archive", f"--output={archive}", COMMIT], check=True)
        with tarfile.open(archive) as tar:
            tar.extractall(sources, filter="data")
        command = [str(sources / "deploy/wheels.sh"), str(python), str(wheels)]
        made = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
        assert made.returncode == 0, made.stdout + made.stderr
        return cls(sources, wheels)

    def install(self, folder: Path, layer: Path) -> None:
        """Write a base of boxes: that release is installed, and its service not begun."""
        with Box(folder, keep=layer) as box:
            box.write(CONFIG_TXT, STOCK)
            shutil.copytree(self.sources / "deploy", box.shared / "last-deploy")
            wheels = share(box, self.wheels)
            installer = str(SHARED_INSIDE / "last-deploy/install.sh")
            box.run(installer, "--framing", "plain", "--wheels", wheels, timeout_s=300)


class Upgrade(Machine):
    """A robot with that release, and this one's installer, which is ended or held at each change that it makes."""

    def __init__(self, box: Box, wheels: Path) -> None:
        super().__init__(box, wheels)
        self.last = self.venv()
        box.write(f"{POINTS}/counted", _COUNTED)
        box.run("sh", "-c", _MAKE)
        self.simulate()

    def forward(self, *, check: bool = True) -> list[str]:
        """To this release."""
        return self.run("--wheels", self.wheels, check=check)

    def back(self, *options: str, check: bool = True) -> list[str]:
        """To the last one."""
        return self.run("--rollback", *options, check=check)

    def begin(self) -> None:
        """The last release runs, and no servo."""
        if self.venv() != self.last:
            self.back("--force")
        self.unit.systemctl("start")

    def counted(self, *, kill: int = 0, wait: Sequence[int] = ()) -> tuple[str, ...]:
        """The command that goes forward, ended at this change, or held at these."""
        self.box.write(f"{POINTS}/count", "0\n")
        self.box.write(f"{POINTS}/kill", f"{kill}\n")
        self.box.write(f"{POINTS}/wait", f"{' '.join(map(str, wait))}\n")
        return "env", f"PATH={POINTS}/bin:{PATH_INSIDE}", INSTALLER, "--wheels", self.wheels

    def points(self) -> list[int]:
        """Some of the changes that the way forward makes, from the first to the last; this release is there already."""
        self.forward()
        self.begin()
        self.box.run(*self.counted(), timeout_s=300)
        last = int(self.box.read(f"{POINTS}/count"))
        self.begin()
        assert last >= PLACES
        return [1 + (last - 1) * (2 * place + 1) // (2 * PLACES) for place in range(PLACES)]

    def runs(self) -> str:
        """The folder of the release that the service's process has loaded."""
        found = re.search(f"/opt/{NAME}/venv-[0-9a-f-]+", self.box.read(f"/proc/{self.unit.property('MainPID')}/maps"))
        assert found is not None
        return found.group()

    def is_at_work(self) -> None:
        """The release that is installed runs and moves a servo, and its last means of stopping is there."""
        assert self.runs() == self.venv()
        assert "accepted" in self.send()
        assert "stop-servos" in self.box.read(f"/etc/systemd/system/{NAME}.service")
        self.box.run(NAME, "stop-servos", "--help")
        self.box.run(NAME, "send", "leg", "3", "stop")

    def hold(self) -> str:
        """Hold leg 3 from now on, by a process of this number."""
        hold = f"{NAME} send leg 3 start 90 45 120 --hold 300"
        held = self.box.run("sh", "-c", f"{hold} >/dev/null 2>&1 & echo $!").stdout.strip()
        self.box.run(f"{self.venv()}/bin/python", "-c", _UNTIL_A_SERVO_RUNS, timeout_s=60)
        return held

    def let_go(self, held: str) -> None:
        """Servos rest again."""
        self.box.run("kill", held)
        self.box.run(NAME, "send", "leg", "3", "stop")
