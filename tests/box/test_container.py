"""deploy/container's page, pasted: podman builds the image and runs it, and each end of it stops the robot.

No registry is asked: the base is a Debian that debootstrap makes, under the name that the Containerfile has. The SPI
device is emulated, so its folder comes in as a volume in place of the node.
"""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.box.box import lacks_tools
from tests.box.installed import NAME, Packages, wait_for_stops
from tests.box.test_pages import debian
from tests.hil.bed import SpiTestbed, missing_packages
from tests.support.child import Child
from tests.support.pages import SUDO, blocks, programs
from tests.support.schedule import skip_where
from tests.support.waiting import Closing

pytestmark = pytest.mark.nightly

DEPLOY: Final = Path(__file__).parents[2] / "deploy"
BASE: Final = "docker.io/library/debian:13-slim"
RAISED: Final = "--ulimit rtprio=20 --ulimit nice=30"
GRANTED: Final = "--ulimit nproc=4096"
"""Not every machine lets its containers have these, nor what podman gives where nobody asks for less."""
DEVICE: Final = "--device /dev/spidev0.0"
CONF: Final = """
[containers]
netns = "host"
[engine]
runtime = "runc"
cgroup_manager = "cgroupfs"
events_logger = "file"
"""
STORAGE: Final = '[storage]\ndriver = "overlay"\ngraphroot = "{0}/images"\nrunroot = "{0}/run"\n'
OWN: Final = "ip link set lo up && echo ready && read -r _"


class Containers(Closing):
    """podman with images, mounts and a loopback of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "containers.conf").write_text(CONF)
        (folder / "storage.conf").write_text(STORAGE.format(folder))
        self._env = {
            "PATH": f"{programs(folder / 'bin', sudo=SUDO)}:{os.environ['PATH']}",
            "CONTAINERS_CONF": str(folder / "containers.conf"),
            "CONTAINERS_STORAGE_CONF": str(folder / "storage.conf"),
            "HOME": str(folder),
        }
        self._own = Child(["unshare", "--mount", "--net", "sh", "-c", OWN], os.environ)
        self._own.wait_for_output("ready")

    def close(self) -> None:
        print(self.run(f"podman logs {NAME}; podman rm --all --force", check=False))  # shown where the test failed
        self._own.close()

    def run(self, line: str, *, check: bool = True, network: bool = False) -> str:
        """Run a shell's line in the folder, and return what it printed. `network`: with this machine's, not its own."""
        spaces = ["--mount", *([] if network else ["--net"])]
        command = ["nsenter", f"--target={self._own.pid}", *spaces, f"--wd={self.folder}", "--", "bash", "-ec", line]
        done = subprocess.run(command, env=self._env, capture_output=True, text=True, check=False, timeout=600)
        assert not check or done.returncode == 0, f"{line}: {done.returncode}\n{done.stdout}{done.stderr}"
        return done.stdout + done.stderr

    def gateway(self, *arguments: str) -> str:
        """Run a command in the container."""
        return self.run(f"podman exec {NAME} {NAME} {' '.join(arguments)}")

    def wait_for_starts(self, starts: int) -> None:
        """Wait until the container's gateway has accepted commands so many times. Restart it if podman has not."""
        ready = f"podman logs {NAME} 2>&1 | grep -c 'is ready'"
        anew = f"podman start {NAME} >/dev/null 2>&1 || true; sleep 0.2"
        self.run(f'until [ "$({ready})" = {starts} ] && podman exec {NAME} true; do {anew}; done')


@pytest.fixture(name="containers")
def make_containers(tmp_path: Path, packages: Packages) -> Iterator[Containers]:
    """Return containers with the base image, and in the folder the repository's files after `make deb`."""
    skip_where(lacks_tools("the container is", "podman", "runc", "debootstrap", "unshare") or missing_packages())
    (tmp_path / "dist").mkdir()
    shutil.copy(packages.make("1.1.0"), tmp_path / "dist")
    shutil.copytree(DEPLOY, tmp_path / "deploy")
    root = debian("trixie", tmp_path / "debian", "python3,python3-spidev")
    with Containers(tmp_path) as containers:
        containers.run(f"tar -C {root} -c . | podman import - {BASE}")
        yield containers


def test_the_image_is_built_and_run_as_the_page_says(containers: Containers, monkeypatch: pytest.MonkeyPatch) -> None:
    build, run = blocks((DEPLOY / "container/README.md").read_text(), "sh")
    etc, folder = containers.folder / "etc", containers.folder / "bed"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    make_deb, *lines = build.replace("/etc/", f"{etc}/").splitlines()
    assert make_deb == "make deb"
    containers.run("\n".join(lines), network=True)
    toml = etc / NAME / "gateway.toml"
    toml.write_text('spi.framing = "plain"\n')
    with SpiTestbed() as bed:
        containers.run(f"chmod -R a+rwX {folder}")
        assert DEVICE in run
        assert RAISED in run
        (preload,) = Path("/usr/lib").glob(f"*/{bed.environment['LD_PRELOAD']}")
        emulated = [f"--volume {folder}:{folder} --volume {preload}:/preload.so:ro"]
        emulated += ["--env LD_PRELOAD=/preload.so", f"--env UMOCKDEV_DIR={bed.environment['UMOCKDEV_DIR']}"]
        run = run.replace(DEVICE, " ".join(emulated)).replace("--volume /etc/", f"--volume {etc}/")
        if subprocess.run(["prlimit", "--nice=30:30", "--rtprio=20:20", "true"], check=False).returncode:
            run = run.replace(RAISED, GRANTED)
        containers.run(run)
        # The gateway's death, and the container's end; the state outlasts both.
        containers.wait_for_starts(1)
        status = containers.run(f"podman exec {NAME} cat /proc/1/status")
        assert all(f"{line}\n" in status for line in ("CapBnd:\t0000000000000000", "NoNewPrivs:\t1")), status
        assert "accepted" in containers.gateway("send leg 3 start 90 45 120")
        first = bed.transfers[-1].opening
        containers.run(f"podman exec {NAME} sh -c 'read -r gateway </proc/1/task/1/children; kill -KILL $gateway'")
        wait_for_stops(bed, opening=first + 1)  # by stop-servos
        containers.wait_for_starts(2)
        assert "stopped" in containers.gateway("estop")
        before, second = len(bed.transfers), bed.transfers[-1].opening
        assert second > first + 1
        containers.run(f"podman stop {NAME}")
        wait_for_stops(bed, opening=second, since=before)
        wait_for_stops(bed, opening=second + 1)
        assert containers.run(f"podman inspect {NAME} --format '{{{{.State.ExitCode}}}}'") == "0\n"
        containers.run(run)
        containers.wait_for_starts(1)
        assert "nothing runs until a reset" in containers.gateway("status")
