"""The package's life on a robot: what installs, is set up, is taken when, stays, and is gone at the end."""

import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from gateway import certs
from release.deb import debian_version
from tests.box.box import SHARED_INSIDE, Box, Unit
from tests.box.installed import (
    BROKEN,
    CONFIG_TXT,
    CONFIGURATION,
    LATE,
    LIBRARY,
    NAME,
    UNIT_FILE,
    Packages,
    Robot,
    current,
    dpkg,
    hold,
    install,
    let_go,
    wait_for_stops,
)

pytestmark = pytest.mark.systemd

PERL = ("libintl", "libmodule-find", "libproc-processtable", "libsort-naturally", "libterm-readkey")
REPLACE = """
library=$(grep -om1 '/usr/lib/x86_64-linux-gnu/libz[.]so.*' /proc/$1/maps)
cp $library $library.new
mv $library.new $library
needrestart -l -r a
"""
"""Upgrade a library that process $1 has loaded, as dpkg does, and let needrestart restart what it may."""
THAW_UNIT = UNIT_FILE.replace("gateway", "thaw")
RECONFIGURE = f"sudo dpkg-reconfigure {NAME}"
CONFIGURE = "sudo dpkg --configure -a"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, packages: Packages) -> Iterator[Robot]:
    """Yield one robot for all tests of this file, with release 1.1.0."""
    with Box(tmp_path_factory.mktemp("robot")) as box:
        install(box, packages.make("1.1.0"))
        with Robot(box) as robot:
            yield robot


@pytest.fixture
def robot(installed: Robot, packages: Packages) -> Robot:
    """Run release 1.1.0."""
    if current(installed.box) != "1.1.0":
        installed.unit.systemctl("stop", check=False)
        install(installed.box, packages.make("1.1.0"))
    installed.configure("")
    installed.unit.systemctl("restart")
    return installed


def test_an_installation_that_is_not_set_up_stays_stopped(tmp_path: Path, packages: Packages) -> None:
    with Box(tmp_path) as box:
        said = install(box, packages.make("1.1.0"))
        assert "hexapod-gateway: Next: sudo hexapod-gateway setup\n" in said, said
        assert box.run("systemctl", "is-active", NAME, check=False).stdout == "inactive\n"
        assert box.run("systemctl", "is-enabled", NAME, check=False).stdout == "disabled\n"
        modes = box.run("stat", "--format=%A %U:%G", f"/etc/{NAME}", CONFIGURATION).stdout.splitlines()
        assert modes == [f"drwxr-x--- root:{NAME}", f"-rw-r----- root:{NAME}"]
        assert set(box.run("id", "--groups", "--name", NAME).stdout.split()) == {NAME, "spi"}
        assert box.run("find", LIBRARY, "!", "-user", "root").stdout == ""
        assert "hexapod-gateway 1." in box.run(NAME, "--version").stdout
        assert dpkg(box, "dpkg", "--verify", NAME) == ""
        own = dpkg(box, "dpkg-query", "--show", "--showformat=${Conffiles}", NAME).split()
        assert own[::2] == ["/etc/needrestart/conf.d/hexapod-gateway.conf"]
        assert "override_rc" in box.read(own[0])
        box.write(own[0], "# a person's")
        assert dpkg(box, "dpkg", "--verify", NAME).split()[1:] == ["c", own[0]]
        assert "not as installed" not in box.run(NAME, "check", check=False).stdout
        assert "warning" not in dpkg(box, "dpkg", "--remove", NAME)
        assert box.exists(CONFIGURATION)
        dpkg(box, "dpkg", "--purge", NAME)
        places = f"/etc/{NAME} {own[0]} /var/lib/{NAME} {LIBRARY} {UNIT_FILE} {THAW_UNIT} /usr/bin/{NAME}"
        assert box.run("sh", "-c", f"ls -d {places}", check=False).stdout == ""


def test_needrestart_names_the_service_and_lets_it_run(robot: Robot) -> None:
    box, pid = robot.box, robot.unit.property("MainPID")
    fetched = ["apt-get", "download", "needrestart", *(f"{name}-perl" for name in PERL)]
    subprocess.run(fetched, cwd=box.shared, check=True, capture_output=True, timeout=300)
    dpkg(box, "sh", "-c", "dpkg --install /box-out/needrestart_*.deb /box-out/lib*-perl_*.deb")
    assert f"{NAME}.service" in dpkg(box, "sh", "-c", REPLACE, "sh", pid)
    assert robot.unit.properties("MainPID", "NRestarts") == [pid, "0"]


def test_the_package_runs_with_any_python_that_fits(installed: Robot) -> None:
    """With each that works, though another is half removed; without any, a sentence says what is missing."""
    box, pythons = installed.box, ("/usr/bin/python3.11", "/usr/bin/python3.13")
    assert not box.exists(pythons[1])
    box.run("mv", pythons[0], "/root/python")
    done = box.run(NAME, "--version", check=False)
    assert (done.returncode, done.stderr) == (
        1,
        f"{NAME}: no Python that it runs with is here ({' '.join(pythons)}): sudo apt-get install python3\n",
    )
    box.run("cp", "/root/python", pythons[1])
    assert f"{NAME} 1." in box.run(NAME, "--version").stdout
    box.write(pythons[0], "#!/bin/sh\nexit 1\n")
    box.run("chmod", "+x", pythons[0])
    assert f"{NAME} 1." in box.run(NAME, "--version").stdout
    box.run("mv", "/root/python", pythons[0])
    box.run("rm", pythons[1])


def test_upgrade_and_back(robot: Robot, packages: Packages) -> None:
    """The state and the configuration stay. The way back is the older package, and nothing asks."""
    box = robot.box
    robot.gateway("estop")
    box.run("sh", "-c", f"echo '# mine' >>{CONFIGURATION}")
    said = install(box, packages.make("1.1.1"))
    assert "warning" not in said
    assert (current(box), robot.runs()) == ("1.1.1", "1.1.1")
    assert "nothing runs until a reset" in robot.gateway("status")
    assert box.read(CONFIGURATION).endswith("# mine\n")
    robot.gateway("reset")
    robot.is_at_work("1.1.1")
    assert "stop-servos" in box.read(UNIT_FILE)
    install(box, packages.make("1.1.0"))
    robot.is_at_work("1.1.0")
    folders = box.run("sh", "-c", f"cd {LIBRARY} && ls").stdout.split()
    assert folders == ["1.1.0", "1.1.1.kept", "current"]


@pytest.mark.parametrize(("release", "change"), [("1.2.0", BROKEN), ("1.2.1", LATE)], ids=["trial", "systemd"])
def test_a_release_that_does_not_start(robot: Robot, packages: Packages, release: str, change: str) -> None:
    """A failed trial changes nothing; under systemd the service returns to the release before."""
    process = robot.unit.property("MainPID")
    said = install(robot.box, packages.make(release, change), check=False)
    if change is BROKEN:
        assert (
            f"{release} does not start: its trial with {CONFIGURATION} printed nothing\nSo the release before" in said
        )
        assert robot.unit.property("MainPID") == process
    else:
        assert f"{release} does not run: journalctl -u {NAME} shows why. 1.1.0 runs again" in said
    robot.is_at_work("1.1.0")
    install(robot.box, packages.make("1.1.1"))
    robot.is_at_work("1.1.1")


def test_an_upgrade_that_fails_its_trial_is_finished_by_the_command_that_is_printed(
    robot: Robot, packages: Packages
) -> None:
    """It may be typed too early. `--back` leads to the release before the one that runs, and forward again."""
    box = robot.box
    install(box, packages.make("1.1.1"))
    robot.configure("watchdog.timeout_mz = 1\n")
    said = [install(box, packages.make("1.2.2"), check=False), dpkg(box, *CONFIGURE.split()[1:], check=False)]
    for each in said:
        assert f"1.2.2 does not start: {CONFIGURATION}: watchdog.timeout_mz: is no setting\n" in each
        assert (
            f"So the release before this one goes on, and each apt command repeats this. Fix it, then: {CONFIGURE}"
            in each
        )
    told = robot.gateway("check", check=False)
    assert "timeout_mz: is no setting. So 1.1.1 goes on, and each apt command repeats the error → fix what is" in told
    robot.configure("")
    assert "go from 1.1.1 to 1.1.0, and" in robot.gateway("setup", "--back", check=False)
    robot.is_at_work("1.1.0")
    assert "go from 1.1.0 to 1.1.1, and" in robot.gateway("setup", "--back", check=False)
    robot.is_at_work("1.1.1")
    dpkg(box, *CONFIGURE.split()[1:])
    robot.is_at_work("1.2.2")
    assert "repeats the error" not in robot.gateway("check", check=False)


def test_the_same_release_again_keeps_the_one_before(robot: Robot, packages: Packages) -> None:
    box = robot.box
    install(box, packages.make("1.1.1"))
    install(box, packages.make("1.1.1"))
    robot.is_at_work("1.1.1")
    dpkg(box, *RECONFIGURE.split()[1:])
    assert box.run("ls", LIBRARY).stdout.split() == ["1.1.0.kept", "1.1.1", "current"]
    robot.gateway("setup", "--back", check=False)
    robot.is_at_work("1.1.0")


def test_a_removal_that_was_cut_off_is_undone_by_the_package(robot: Robot, packages: Packages) -> None:
    """A service that somebody has stopped stays so, and the command that starts it is printed."""
    box = robot.box
    box.run("sh", "-c", f"echo 'kill -KILL $PPID' >>/var/lib/dpkg/info/{NAME}.prerm")
    dpkg(box, "dpkg", "--remove", NAME, check=False)
    told = robot.gateway("check", check=False)
    assert (
        "1.1.0 is only partly installed: dpkg was interrupted → sudo dpkg --install ./hexapod-gateway_VERSION" in told
    )
    install(box, packages.make("1.1.0"))
    robot.is_at_work("1.1.0")
    robot.unit.systemctl("stop")
    assert f"The service is stopped, as before. To start it: sudo systemctl start {NAME}" in install(
        box, packages.make("1.1.0")
    )
    assert robot.unit.property("ActiveState") == "inactive"


def test_a_full_disk_leaves_the_release_that_runs(robot: Robot, packages: Packages) -> None:
    """The switch to another one happens whole, or not at all, and the printed command repeats it."""
    box, process = robot.box, robot.unit.property("MainPID")
    units, full = "/usr/lib/systemd/system", "/run/full"
    box.run("sh", "-c", f"mkdir {full} && mount -t tmpfs -o size=8m tmpfs {full} && cp -a {units}/. {full}")
    box.run("sh", "-c", f"cat /dev/zero >{full}/zero; mount --bind {full} {units}", check=False)
    said = install(box, packages.make("1.1.1"), check=False)
    assert ".new: No space left on device\nSo the release before" in said, said
    assert (current(box), robot.unit.property("MainPID")) == ("1.1.0.kept", process)
    box.run("umount", units)
    dpkg(box, *CONFIGURE.split()[1:])
    robot.is_at_work("1.1.1")


def test_a_servo_runs_during_the_upgrade(robot: Robot, packages: Packages) -> None:
    """The robot goes on as it stands, and the new release is taken by the command that is printed."""
    robot.configure("watchdog.timeout_ms = 10000\nlease.ttl_ms = 10000\n")  # dpkg may take the processor for a while
    robot.unit.systemctl("restart")
    process, held = robot.unit.property("MainPID"), hold(robot.box)
    said = install(robot.box, packages.make("1.1.1"))
    assert (
        f"a servo runs, so the service goes on with the release before this one. Stop the robot, then: {RECONFIGURE}"
        in said
    )
    assert robot.unit.property("MainPID") == process
    dpkg(robot.box, *RECONFIGURE.split()[1:])
    assert robot.unit.property("MainPID") == process
    let_go(robot.box, held)
    robot.is_at_work("1.1.0")
    dpkg(robot.box, *RECONFIGURE.split()[1:])
    robot.is_at_work("1.1.1")


def test_a_service_that_does_not_report_its_servos_counts_as_one_that_holds_the_robot(
    robot: Robot, packages: Packages
) -> None:
    box, process = robot.box, robot.unit.property("MainPID")
    box.run("sh", "-c", f"printf '%020d 0\n' 1 >/run/stale && mount --bind /run/stale /run/{NAME}/servos")
    said = install(box, packages.make("1.1.1"))
    box.run("umount", f"/run/{NAME}/servos")
    command = f"sudo systemctl stop {NAME} && {RECONFIGURE} && sudo systemctl start {NAME}"
    assert f"See that no servo runs, then: {command}" in said
    assert robot.unit.property("MainPID") == process
    dpkg(box, "sh", "-c", command.replace("sudo ", ""))
    robot.is_at_work("1.1.1")


def test_removed_and_installed_again_it_runs_as_before(robot: Robot, packages: Packages) -> None:
    box = robot.box
    robot.gateway("estop")
    since = len(robot.bed.transfers)
    assert "warning" not in dpkg(box, "dpkg", "--remove", NAME)
    wait_for_stops(robot.bed, since=since)
    assert robot.unit.property("ActiveState") == "inactive"
    assert not box.exists(LIBRARY)
    install(box, packages.make("1.1.0"))
    assert "nothing runs until a reset" in robot.gateway("status")
    robot.gateway("reset")
    robot.is_at_work("1.1.0")


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

        drop_in = f"/etc/systemd/system/{NAME}.service.d/simulated.conf"
        box.run("install", "-Dm644", f"/usr/share/{NAME}/simulated.conf", drop_in)
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


def test_debian_sorts_the_versions_as_they_were_made() -> None:
    order = [
        debian_version(released, when)
        for released, when in [
            ("1.2.0.dev1", 9), ("1.2.0a1", 8), ("1.2.0rc1", 7), ("1.2.0rc2", 6), ("1.2.0", 5),
            ("1.2.0+gfffffff", 60), ("1.2.0+g0000000.changed", 61), ("1.10.0", 1),
        ]
    ]  # fmt: skip
    assert order[-2] == "1.2.0+19700101000101.g0000000.changed"
    for older, newer in pairwise(order):
        assert subprocess.run(["dpkg", "--compare-versions", older, "lt", newer], check=False).returncode == 0, newer
