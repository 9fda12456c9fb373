"""A robot's computer in a box: the gateway installed, its service under systemd, every byte on SPI seen by the test."""

from pathlib import Path

import pytest

from gateway.model.frames import stop_leg
from schemas.robot import LEGS
from tests.box.box import SHARED_INSIDE, Box, Unit
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
