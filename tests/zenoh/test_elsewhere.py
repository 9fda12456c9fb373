"""Client and commands on macOS and Windows: without what only POSIX or Linux has (tests/support/elsewhere.py)."""

import os
import re
import signal
import sys
from pathlib import Path

import pytest

from tests.support.child import Child
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import Gateway, free_port

gateway = gateway_fixture(patient(4000, lease={"ttl_ms": 10_000}))

PROGRAM = """
import asyncio
from tests.support import elsewhere
elsewhere.forget()
from gateway.client import AsyncClient, Client
POSE = [(90, 45, 120)] * 6
with Client({endpoint!r}) as robot:
    robot.wait_ready()
    with robot.lease(), robot.stream(20) as stream:
        stream.set(POSE)
        stream.set(POSE)
async def walks():
    async with AsyncClient({endpoint!r}) as robot, robot.walk() as walk:
        await walk.stand()
asyncio.run(walks())
print("done")
"""


def elsewhere(*arguments: str, **environment: str) -> Child:
    command = [sys.executable, "-m", "tests.support.elsewhere", "gateway", *arguments]
    return Child(command, {**os.environ, **environment})


def test_a_program_runs_without_what_only_linux_has(gateway: Gateway) -> None:
    child = Child([sys.executable, "-c", PROGRAM.format(endpoint=gateway.endpoint)], os.environ)
    assert child.wait(60) == 0, child.stderr
    child.close()
    assert child.stdout == "done\n"


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("send", "legs", "start", "90", "45", "120"), 0, "accepted"),
        (("stop",), 0, "all six legs are stopped"),
        (("status",), 0, "No servo runs"),
        (("walk", "--forward", "0.05", "--seconds", "0.2"), 0, "walked 0.0"),
        (("walk",), 1, "needs a Unix terminal; on Windows, run it in WSL, or use --seconds"),
    ],
    ids=["send", "stop", "status", "walk", "walk by keys"],
)
def test_a_command_runs_without_what_only_linux_has(
    gateway: Gateway, arguments: tuple[str, ...], code: int, said: str
) -> None:
    child = elsewhere(*arguments, "--connect", gateway.endpoint)
    assert child.wait(60) == code, child.stderr
    child.close()
    assert said in child.stdout + child.stderr
    assert "Traceback" not in child.stderr


@pytest.mark.parametrize(
    ("arguments", "begun"),
    [
        ("status --follow", "No servo runs"),
        ("record {folder}/ride.mcap", "recording into"),
        ("console --listen 127.0.0.1:{port}", "The console is at http://"),
    ],
    ids=["status", "record", "console"],
)
def test_a_command_that_goes_on_until_ctrl_c(gateway: Gateway, tmp_path: Path, arguments: str, begun: str) -> None:
    name, *given = arguments.format(folder=tmp_path, port=free_port()).split()
    state = {"XDG_STATE_HOME": str(tmp_path)}
    with elsewhere(name, *given, "--connect", gateway.endpoint, **state) as child:
        child.wait_for_output(begun, timeout_s=60)
        if name == "console":
            with elsewhere(name, "--link", *given, **state) as link:
                assert link.wait(60) == 0, link.stderr
            assert re.search(r"The console is at http://127\.0\.0\.1:\d+/\?token=", link.stdout)
        child.send_signal(signal.SIGINT)
        assert child.wait(60) == 0, child.stderr
    assert "Traceback" not in child.stderr
    assert (tmp_path / "ride.mcap").exists() == (name == "record")
