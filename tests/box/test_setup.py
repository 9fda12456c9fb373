"""`setup` on a robot with the package installed: from nothing to certificates, and back to the kept release."""

from pathlib import Path

import pytest

from gateway import certs
from tests.box.box import SHARED_INSIDE, Box, Unit
from tests.box.installed import CONFIGURATION, NAME
from tests.box.package import CONFIG_TXT, LIBRARY, Packages, hold, install, let_go

pytestmark = pytest.mark.systemd

SIMULATED = (Path(__file__).parents[2] / "deploy/systemd/simulated.conf").read_text()


def setup(box: Box, *options: str, check: bool = False) -> list[str]:
    """Return the lines that `setup` printed, before those of `check`, which may find that this machine has no SPI."""
    done = box.run(NAME, "setup", *options, check=check, timeout_s=120)
    assert "Traceback" not in done.stderr
    return (done.stdout + done.stderr).splitlines()


def test_setup_goes_from_the_package_to_a_robot_with_certificates_and_back(tmp_path: Path, packages: Packages) -> None:
    with Box(tmp_path) as box:
        box.write(CONFIG_TXT, "#dtparam=spi=on\n")
        install(box, packages.make("1.1.0"))
        unit = Unit(box, f"{NAME}.service")
        done = setup(box, "--framing", "plain", check=True)
        assert done[-1] == "Next: sudo reboot; then: sudo hexapod-gateway check"
        assert unit.properties("UnitFileState", "ActiveState") == ["enabled", "inactive"]
        assert box.run("stat", "--format=%A %U:%G", CONFIGURATION).stdout == f"-rw-r----- root:{NAME}\n"

        box.write(f"/etc/systemd/system/{NAME}.service.d/simulated.conf", SIMULATED)
        box.run("systemctl", "daemon-reload")
        assert "start the service" in setup(box)
        process = unit.property("MainPID")
        assert "the service runs with this setup" in setup(box)
        assert unit.property("MainPID") == process

        folder = tmp_path / "certs"
        certs.folder.init(folder, ["127.0.0.1"])
        certs.folder.issue(folder, "robot-2", "robot", hosts=["127.0.0.1"], bundle=box.shared / "robot.zip")
        certs.folder.issue(folder, "anna", "operator", bundle=box.shared / "anna.zip")
        assert "restart the service: all legs stop" in setup(box, "--certs", f"{SHARED_INSIDE}/robot.zip")
        unzip = f"import zipfile; zipfile.ZipFile('{SHARED_INSIDE}/anna.zip').extractall('/root/anna')"
        box.run("python3", "-c", unzip)
        anna = ("--zenoh-config", "/root/anna/anna.json5")
        held = hold(box, *anna)
        before, process = box.read(CONFIGURATION), unit.property("MainPID")
        assert setup(box, "--framing", "length-prefixed")[-1].startswith(
            f"{NAME}: a servo runs, and a restart would stop it"
        )
        assert (box.read(CONFIGURATION), unit.property("MainPID")) == (before, process)
        let_go(box, held, *anna)

        install(box, packages.make("1.1.1"))
        said = setup(box, "--back")
        assert said[0] == "go from 1.1.1 to 1.1.0, and restart the service"
        assert box.run("readlink", f"{LIBRARY}/current").stdout == "1.1.0.kept\n", said
        assert unit.property("ActiveState") == "active"
        assert box.run(NAME, "status", *anna, check=False).returncode == 0
