"""The console as a service of its own, beside the gateway's: installed, signed in to, kept in its place, removed."""

import json
import os
import re
import shlex

import pytest

from tests.box.box import Unit
from tests.box.installed import NAME, PYTHON, InstalledGateway, dpkg
from tests.support.child import Child

pytestmark = [pytest.mark.systemd, pytest.mark.nightly]

CONSOLE = "hexapod-console"
SIGN_IN = """
import http.client, sys, urllib.parse
link = urllib.parse.urlsplit(sys.argv[1])
there = http.client.HTTPConnection(link.netloc)
there.request("GET", f"/?{link.query}")
answer = there.getresponse()
answer.read()
print(answer.status, answer.headers["Set-Cookie"].partition(";")[0])
"""
SESSION = """
import http.client, sys
there = http.client.HTTPConnection("127.0.0.1:8080")
there.request("GET", "/session", headers={"Cookie": sys.argv[1]})
answer = there.getresponse()
print(answer.status, answer.read().decode())
"""
THIEF = """
import pathlib, socket
print("waits for the port", flush=True)
while not pathlib.Path("/box-out/enough").exists():
    try:
        taken = socket.create_server(("127.0.0.1", 8080))
    except OSError:
        continue
    print("got", taken, flush=True)
"""
"""Another user of the machine, who takes the port where nobody listens: Python sets SO_REUSEADDR."""


def test_the_console_is_installed_used_and_removed(robot: InstalledGateway) -> None:
    box, unit = robot.box, Unit(robot.box, f"{CONSOLE}.service")
    robot.unit.systemctl("start")
    process = robot.unit.property("MainPID")
    said = robot.gateway("setup", "--console", check=False)
    assert f"enable {CONSOLE}.service and {CONSOLE}.socket: starts with the machine" in said
    assert robot.unit.property("MainPID") == process, "the robot goes on"
    assert unit.properties("ActiveState", "UnitFileState") == ["active", "enabled"]

    says = f"journalctl --unit {CONSOLE} --output=cat"
    journal = box.run("sh", "-c", f"until {says} | grep 'For a browser:'; do :; done; {says}", timeout_s=60).stdout
    assert "token=" not in journal, "a journal is kept"
    command = re.findall("For a browser: sudo (.*)", journal)[-1]
    link = box.run(*shlex.split(command)).stdout.split()[4]
    status, cookie = box.run(*PYTHON, SIGN_IN, link).stdout.split()
    assert status == "303"
    as_nobody = ("setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", "--")
    with Child(box.command(*as_nobody, *PYTHON, THIEF), os.environ) as thief:
        thief.wait_for_output("waits for the port")
        for command in ("restart", "kill --signal=KILL"):
            box.run("systemctl", *command.split(), unit.name)
            assert box.run(*PYTHON, SESSION, cookie).stdout.startswith("200"), "a restart signs nobody out"
        (box.shared / "enough").touch()
        assert thief.wait() == 0, thief
        assert "got" not in thief.stdout, thief
    boot = box.read("/proc/sys/kernel/random/boot_id").strip().replace("-", "")
    assert json.loads(box.read(f"/var/lib/{CONSOLE}/console-8080.json"))["written"][0] == boot, "not by the wall clock"

    pid = unit.property("MainPID")
    status_of = box.read(f"/proc/{pid}/status")
    user = box.run("id", "--user", CONSOLE).stdout.strip()
    assert f"Uid:\t{user}\t{user}" in status_of
    assert "CapBnd:\t0000000000000000" in status_of
    inside = ("nsenter", f"--target={pid}", "--mount", "--")
    assert box.run(*inside, "ls", f"/etc/{NAME}").stdout == "", "the gateway's keys are not its own"
    assert "spidev" not in box.run(*inside, "ls", "/dev").stdout

    assert "1 session ended" in box.run(NAME, "console", "--sign-out").stdout
    assert box.run(*PYTHON, SESSION, cookie).stdout.startswith("403")

    assert "the console runs\n" in robot.gateway("setup", check=False)

    # Two addresses: the unit's is the one (tests/unit/people/test_console_site.py).
    box.write(f"/etc/{CONSOLE}/console.conf", "CONSOLE_OPTIONS=--listen 127.0.0.1:8091\n")
    unit.systemctl("restart")
    box.run("sh", "-c", f"until systemctl is-failed {CONSOLE}.service; do :; done", timeout_s=60)
    assert unit.property("ExecMainStatus") == "2"
    assert Unit(box, f"{CONSOLE}.socket").property("ActiveState") == "active", "nobody else gets the port"

    dpkg(box, "dpkg", "--purge", NAME)
    assert unit.property("LoadState") == "not-found"
    assert Unit(box, f"{CONSOLE}.socket").property("ActiveState") == "inactive"
    assert not box.exists(f"/var/lib/{CONSOLE}")
