"""The console as a service of its own, beside the gateway's: installed, signed in to, kept in its place, removed."""

import pytest

from tests.box.box import SHARED_INSIDE, Unit
from tests.box.installed import INSTALLER, NAME, InstalledGateway

pytestmark = pytest.mark.systemd

CONSOLE = "hexapod-console"
LISTENS = """
import socket, time
while socket.socket().connect_ex(("127.0.0.1", 8080)) != 0:
    time.sleep(0.05)
"""
SIGN_IN = """
import http.client, sys, urllib.parse
link = urllib.parse.urlsplit(sys.argv[1])
there = http.client.HTTPConnection(link.netloc)
there.request("GET", f"/?{link.query}")
answer = there.getresponse()
answer.read()
key = answer.headers["Location"].partition("#")[2]
print(answer.status, answer.headers["Set-Cookie"].partition(";")[0], key)
"""
SESSION = """
import http.client, sys
there = http.client.HTTPConnection("127.0.0.1:8080")
there.request("GET", "/session", headers={"Cookie": sys.argv[1]})
answer = there.getresponse()
print(answer.status, answer.read().decode())
"""


def test_console(robot: InstalledGateway) -> None:
    box, unit = robot.box, Unit(robot.box, f"{CONSOLE}.service")
    options = ("--framing", "plain", "--wheels", str(SHARED_INSIDE / "wheels"))
    before = box.run("ls", f"/opt/{NAME}").stdout
    said = box.run(INSTALLER, *options, "--console", timeout_s=300).stdout
    assert f"make the user {CONSOLE}" in said
    assert "restart the service" not in said, "the robot goes on"
    assert box.run("ls", f"/opt/{NAME}").stdout == before
    assert unit.properties("ActiveState", "UnitFileState") == ["active", "enabled"]

    python = f"/opt/{NAME}/venv/bin/python"
    box.run(python, "-c", LISTENS, timeout_s=20)
    link = box.run(NAME, "console", "--link").stdout.split()[4]
    assert "token=" not in box.run("journalctl", "--unit", CONSOLE, "--output=cat").stdout, "a journal is kept"
    status, cookie, key = box.run(python, "-c", SIGN_IN, link).stdout.split()
    assert status == "303"
    unit.systemctl("restart")
    box.run(python, "-c", LISTENS, timeout_s=20)
    assert box.run(python, "-c", SESSION, cookie, key).stdout.startswith("200"), "a restart signs nobody out"

    pid = unit.property("MainPID")
    status_of = box.read(f"/proc/{pid}/status")
    user = box.run("id", "--user", CONSOLE).stdout.strip()
    assert f"Uid:\t{user}\t{user}" in status_of
    assert "CapBnd:\t0000000000000000" in status_of
    inside = ("nsenter", f"--target={pid}", "--mount", "--")
    assert box.run(*inside, "ls", f"/etc/{NAME}").stdout == "", "the gateway's keys are not its own"
    assert "spidev" not in box.run(*inside, "ls", "/dev").stdout

    assert "1 session ended" in box.run(NAME, "console", "--revoke").stdout
    assert box.run(python, "-c", SESSION, cookie, key).stdout.startswith("403")

    again = box.run(INSTALLER, *options).stdout.splitlines()
    assert f"keep /etc/{CONSOLE}/console.conf, your options" in again
    assert not [line for line in again if "restart" in line or "start the console" in line]
    gone = box.run(INSTALLER, "--uninstall").stdout
    assert f"remove the user {CONSOLE}" in gone
    assert unit.property("LoadState") == "not-found"
    assert not box.exists(f"/var/lib/{CONSOLE}")
