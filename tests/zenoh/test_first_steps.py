"""The lines that a newcomer or a technician copies from the terminal, run as they are printed."""

import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.client import Client
from tests.support.child import Child
from tests.support.command import parse
from tests.support.console_process import LINK
from tests.support.gateway_process import COMMAND, READY, free_port
from tests.support.heard import frames
from tests.support.runs import MARK, Run
from tests.support.waiting import wait_until

REPOSITORY = Path(__file__).parents[2]


def test_make_run_keeps_an_incident_finds_a_port_and_ends_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With port 8080 taken; what it prints at last is where the console is. The gateway goes on without the console."""
    monkeypatch.setenv(MARK, os.environ[MARK])  # as it was, afterwards
    run = Run()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    env = {**os.environ, "XDG_STATE_HOME": str(tmp_path), "HEXAPOD_ZENOH__LISTEN": f'["{endpoint}"]'}
    for name in ("STATE_DIRECTORY", "MAKELEVEL"):  # below another make it would print which folder it enters
        env.pop(name, None)
    start = ["make", "--old-file", f"{sys.prefix}/run", "run", f"VENV={sys.prefix}"]
    with socket.socket() as other:
        with suppress(OSError):  # somebody else may have it already
            other.bind(("127.0.0.1", 8080))
            other.listen()
        child = Child(["setsid", *start], env, cwd=REPOSITORY)
        try:
            child.wait_for_output(READY)
            address = child.wait_for_output(LINK).removeprefix(LINK)
            port = int(address.removeprefix("http://127.0.0.1:").partition("/")[0])
            assert port > 8080
            child.wait_for_output(f"Port 8080 is taken by another program, so the console listens on {port}.")
            assert child.stdout.splitlines()[-1].startswith(LINK)
            walk = child.wait_for_output("or, from the keyboard: ")
            assert walk.rstrip().endswith(f"bin/hexapod-gateway walk --connect {endpoint}")
            child.wait_for_output("Try, in a second terminal: ")
            lines = child.stdout.splitlines()
            begins = ("Try, in a second terminal: ", "or, from the keyboard: ", "For a browser: ")
            commands = [line for line in lines if line.startswith(begins)]
            assert [begin for line in lines for begin in (READY, LINK) if line.startswith(begin)] == [READY, LINK]
            assert len(commands) == len(begins) == len(lines) - 2  # in any order: each program writes its own
            for line in commands:
                parse(line.partition(": ")[2], called=f"{sys.prefix}/bin/hexapod-gateway")
            with Client(endpoint, timeout_s=5) as client:
                seen = frames(client)
                assert client.start_leg(3, 90, 45, 120).accepted
                seen.wait(lambda frame: frame.cause == "watchdog")
            again = [sys.executable, "-m", "gateway.onboard.try_out", "no"]
            second = subprocess.run(again, env=env, capture_output=True, text=True, check=False)
            taken = f"hexapod-gateway: {endpoint} is taken by another program"
            assert (second.returncode, second.stdout, second.stderr.count("\n")) == (4, "", 1), second
            assert second.stderr.startswith(taken)
            command = [*COMMAND, "check", "--connect", endpoint]
            told = subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
            assert not re.search("^(failure|warning  SPI)", told, re.MULTILINE), told
            assert told.splitlines()[-1].startswith("This machine can reach the gateway")
            command = [*COMMAND, "incidents", "show", "last"]
            assert "leg 3" in subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
            (console,) = [pid for pid in run.processes() if b"\0console\0" in Path(f"/proc/{pid}/cmdline").read_bytes()]
            os.kill(console, signal.SIGKILL)
            with Client(endpoint, timeout_s=5) as client:
                assert client.state().mode == "idle"
            child.terminate()
            child.wait(20)
            assert "Traceback" not in child.stderr
            wait_until(lambda: not run.processes(), "all have ended: make itself does not wait", 10)
        finally:
            run.close()
            child.close()
