"""`check` finds each fault of a table on an installed robot; the remedy that it prints, run to the letter, helps."""

import re
import subprocess
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from tests.box.box import Box
from tests.box.faults import CERTS, FAULTS, GIVEN, NAMES, OTHER, Fault
from tests.box.installed import NAME, Packages, install, share
from tests.box.installed import Robot as Packaged

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

PROGRAM = f"/usr/bin/{NAME}"
KEPT = "/etc/passwd /etc/group /etc/shadow /etc/gshadow /etc/hexapod-gateway /etc/systemd/system $unit $rules"
KEPT += f" {PROGRAM} /usr/lib/{NAME}"
PREPARE = f"""
for each in {CERTS} {OTHER}; do
    {NAME} certs init --dir $each --host 127.0.0.1
    for name in anna carl; do {NAME} certs issue $name --role operator --dir $each; done
    {NAME} certs revoke carl --dir $each || [ $? = 1 ]  # no robot confirms it yet
done
mkdir $pki
cp {CERTS}/ca.pem {CERTS}/gateway.* $pki
cat >$toml <<'END'
spi.framing = "length-prefixed"
zenoh.config = "/etc/hexapod-gateway/zenoh/gateway.json5"
zenoh.listen = ["tls/127.0.0.1:7447"]
END
chown -R root:$service $etc && chmod -R u=rwX,g=rX,o= $etc
cp -p $toml /root
systemctl restart $service
{NAME} certs revoke --dir {CERTS}
tar -cPpf /root/kept.tar {KEPT} $state
"""
UNDO = f"""
systemctl stop $service || true
umount $state || true
rm -rf $state $units/$service* /usr/lib/{NAME} /usr/local/bin/$service
systemctl unset-environment HEXAPOD_LIMITS__LEG_RATE_HZ
tar -xPpf /root/kept.tar
chgrp -R spi /box-out/bed && chmod -R g+rwX /box-out/bed
systemctl daemon-reload
systemctl reset-failed
systemctl start $service
"""


class Line(NamedTuple):
    """A warning or failure of `check`."""

    sentence: str
    fix: str


class Robot:
    """An installed robot with certificates, of which `check` has nothing new to say."""

    def __init__(self, installed: Packaged) -> None:
        self.installed = installed
        self.env = dict(each.split("=", 1) for each in installed.emulated)
        self.shell(f"ln -sf {self.env['UMOCKDEV_DIR']}/dev/spidev0.0 /dev/spidev0.0")
        own = f"[ ${{1##*/}} != {NAME} ] || set -- env {' '.join(installed.emulated)} $*"
        installed.box.write("/usr/local/bin/sudo", f'#!/bin/sh\n{own}\nexec "$@"\n')
        self.shell(f"chmod +x /usr/local/bin/sudo\n{PREPARE}")
        self.usual = set(self.check())
        """Lines that any box has, such as about its clock."""

    def shell(self, text: str) -> str:
        done = self.installed.box.run("bash", "-c", NAMES + text, timeout_s=200, check=False)
        print(text, done.stdout, done.stderr, sep="\n")
        if done.returncode:
            raise subprocess.CalledProcessError(done.returncode, text, done.stdout, done.stderr)
        return done.stdout

    def check(self) -> list[Line]:
        """Return what is not well. Without such a line it has to be content, and with a failure it must not be."""
        done = self.installed.box.run(PROGRAM, "check", env=self.env, check=False)
        print(done.stdout, done.stderr)
        said = (done.stdout + done.stderr).splitlines()
        assert done.returncode == (("\nfailure" in f"\n{done.stdout}") if done.stdout else 2)
        found = [line[24:] for line in said if line.startswith(("warning", "failure"))]
        found += [line for line in said if line.startswith(f"{NAME}: ")]
        return [Line(*(line.split(" → ", 1) if " → " in line else (line, ""))) for line in found]

    def new(self) -> list[Line]:
        return [line for line in self.check() if line not in self.usual]


@pytest.fixture(scope="module")
def well(tmp_path_factory: pytest.TempPathFactory, packages: Packages) -> Iterator[Robot]:
    with Box(tmp_path_factory.mktemp("robot")) as box:
        install(box, packages.make("1.1.0"))
        share(box, packages.make("1.1.1"))
        with Packaged(box) as installed:
            yield Robot(installed)


@pytest.fixture
def robot(well: Robot, request: pytest.FixtureRequest) -> Iterator[Robot]:
    failed = request.session.testsfailed
    yield well
    if request.session.testsfailed != failed:
        well.shell(UNDO)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.what)
def test_a_fault_is_named_and_its_remedy_helps(robot: Robot, fault: Fault) -> None:
    """Plant the fault, check, run what follows the arrow, and check again."""
    robot.shell(fault.plant)
    found = robot.new()
    named = [line for line in found if fault.says in f"{line.sentence} → {line.fix}"]
    assert named, f"nothing says {fault.says!r}"
    if fault.by_hand:
        robot.shell(fault.by_hand)
    else:
        follow(robot, named[0])
    for _ in range(fault.more):
        follow(robot, robot.new()[0])
    assert not robot.new()
    if fault.then:
        robot.shell(fault.then)


def follow(robot: Robot, line: Line) -> None:
    command = re.search(r"sudo .*", line.fix)
    assert command, f"{line.fix!r} has no command"
    filled_in = command[0]
    for word, meant in GIVEN.items():
        filled_in = re.sub(rf"(?<![\w/]){re.escape(word)}(?!\w)", meant, filled_in)
    robot.shell(filled_in)


def test_somebody_who_may_not_look_is_not_answered_with_a_traceback(well: Robot) -> None:
    stranger = ("setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", "--")
    done = well.installed.box.run(*stranger, PROGRAM, "check", check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.endswith("is not for you to read, as it may name keys: sudo hexapod-gateway check\n")
    assert "Traceback" not in done.stderr
