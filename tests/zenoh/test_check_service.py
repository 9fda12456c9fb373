"""`check` beside an installed service, as root and as others: with a user of its own, in a mount namespace."""

import os
import shutil
import socket
import subprocess
import sysconfig
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway import certs
from gateway.host.kernel_tables import listening
from tests.hil.bed import SYSTEM_PYTHON
from tests.support.child import Child
from tests.support.gateway_process import READY, free_port, write_settings

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="makes a user in a mount namespace")

UID = 61234
STRANGER = 61235
ROOT = Path(__file__).parents[2]
GATEWAY = (SYSTEM_PYTHON, "-m", "gateway")
"""A Python that the service's user may read, as the installer demands."""
ENV = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), sysconfig.get_path("platlib")])}


class Machine:
    """A folder like /etc/hexapod-gateway, on a machine that has the service's user."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        folder.chmod(0o755)
        for name, line in (
            ("passwd", f"hexapod-gateway:x:{UID}:{UID}::/nonexistent:/usr/sbin/nologin"),
            ("group", f"hexapod-gateway:x:{UID}:"),
        ):
            (folder / name).write_text(Path("/etc", name).read_text() + line + "\n")
        certs.folder.init(folder / "zenoh", ["127.0.0.1"], port=self.port)
        zenoh = {"config": str(folder / "zenoh" / "gateway.json5")}
        self.config = write_settings(folder / "gateway.toml", {"zenoh": zenoh, "spi": {"framing": "plain"}})

    def allow(self) -> None:
        """As the installer does."""
        for path in (self.config, self.folder / "zenoh", *(self.folder / "zenoh").iterdir()):
            os.chown(path, 0, UID)
            path.chmod(0o750 if path.is_dir() else 0o640)

    def spawn(self, *arguments: str, uid: int = 0, without: str = "") -> Child:
        """`without`: rights that root has not, as in a container."""
        user = [f"--reuid={uid}", f"--regid={uid}", "--clear-groups", "--bounding-set=-all"] if uid else []
        user += [f"--bounding-set={without}"] if without else []
        bind = "; ".join(f"mount --bind {self.folder}/{name} /etc/{name}" for name in ("passwd", "group"))
        command = ["unshare", "--mount", "sh", "-ec", f'{bind}; exec "$@"', "sh", "setpriv", *user, "--", *GATEWAY]
        return Child([*command, *arguments], {**ENV, "PATH": f"{self.folder}:{os.environ['PATH']}"})

    def unit_grants(self, rtprio: int) -> None:
        """As systemd says it of the unit."""
        systemctl = self.folder / "systemctl"
        systemctl.write_text(f"#!/bin/sh\necho LoadState=loaded; echo LimitRTPRIO={rtprio}; echo MainPID=0\n")
        systemctl.chmod(0o755)

    def check(self, uid: int = 0, without: str = "") -> Child:
        child = self.spawn("check", "--config", str(self.config), uid=uid, without=without)
        child.wait()
        child.close()
        return child


@pytest.fixture
def machine() -> Iterator[Machine]:
    reads = ["setpriv", f"--reuid={UID}", f"--regid={UID}", "--clear-groups", "--", *GATEWAY, "--version"]
    if subprocess.run(reads, env=ENV, capture_output=True, check=False).returncode:
        pytest.skip("others may not read this folder, or its packages are for another Python")
    folder = Path(tempfile.mkdtemp(prefix="check-"))  # pytest's own folders are for their owner only
    yield Machine(folder)
    shutil.rmtree(folder)


def line(child: Child, name: str) -> str:
    return next(line for line in child.stdout.splitlines() if line[9:].startswith(name))


def test_a_key_that_root_copied_is_a_failure_though_root_can_read_it(machine: Machine) -> None:
    machine.allow()
    key = machine.folder / "zenoh" / "gateway.key"
    os.chown(key, 0, 0)
    key.chmod(0o600)
    child = machine.check()
    assert child.returncode == 1, str(child)
    told = [each for each in child.stdout.splitlines() if "gateway.key: Permission denied" in each]
    assert told
    assert all(each.startswith("failure") and "sudo chown -R root:hexapod-gateway" in each for each in told)
    machine.allow()
    child = machine.check()
    assert "Permission denied" not in child.stdout
    assert line(child, "user").startswith("ok ")
    assert line(child, "Zenoh").startswith("ok ")
    assert "RLIMIT_RTPRIO is 0)" in line(child, "real-time"), "by the service's rights"


@pytest.mark.parametrize(
    ("without", "name", "says"),
    [
        ("-sys_resource,-sys_nice", "real-time", "priority 20 is not granted"),
        ("-setuid", "user", "all this is what root may do; the service is hexapod-gateway"),
    ],
)
def test_in_a_container_without_a_right_it_says_what_it_cannot_try(
    machine: Machine, without: str, name: str, says: str
) -> None:
    machine.allow()
    machine.unit_grants(20)
    child = machine.check(without=without)
    assert child.stderr == ""
    assert line(child, name).startswith("warning")
    assert says in line(child, name)


def test_whoever_may_not_read_the_configuration_is_informed_how(machine: Machine) -> None:
    machine.allow()
    child = machine.check(STRANGER)
    assert (child.returncode, child.stdout) == (2, ""), str(child)
    assert child.stderr == (
        f"hexapod-gateway: {machine.config} is not for you to read, as it may name keys: sudo hexapod-gateway check\n"
    )
    machine.config.chmod(0o644)
    for path in ((machine.folder / "zenoh"), *(machine.folder / "zenoh").iterdir()):
        path.chmod(0o755)
    child = machine.check(STRANGER)
    assert line(child, "user").startswith(
        "warning  user           all this is what you may do; the service is hexapod-"
    )


def test_the_port_of_the_service_is_the_services(machine: Machine) -> None:
    machine.allow()
    service = machine.spawn("run", "--sim", "--config", str(machine.config), uid=UID)
    try:
        service.wait_for_output(f"{READY}: tls/[::]:{machine.port}", timeout_s=20)
        service.wait_for_output("Try, on a laptop: hexapod-gateway check --zenoh-config NAME.json5")
        child = machine.check()
        assert line(child, "port").startswith(
            f"ok       port           tls/[::]:{machine.port} is in use by the gateway"
        )
    finally:
        service.close()


def test_a_port_of_another_program_is_not(machine: Machine) -> None:
    machine.allow()
    with socket.create_server(("", machine.port)):
        assert {uid for _, uid in listening(machine.port, socket.SOCK_STREAM)} == {0}
        assert "is taken by another program" in line(machine.check(), "port")
