"""The lines that a newcomer or a technician copies from the terminal, run as they are printed."""

import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from gateway.client import Client
from tests.support.child import Child
from tests.support.console_process import LINK
from tests.support.gateway_process import COMMAND, READY, free_port
from tests.support.heard import frames

REPOSITORY = Path(__file__).parents[2]


def test_the_first_incident_of_a_newcomer_is_kept_and_the_console_finds_a_port(tmp_path: Path) -> None:
    """`make run` with port 8080 taken; what it prints at last is where the console is."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    env = {**os.environ, "XDG_STATE_HOME": str(tmp_path), "HEXAPOD_ZENOH__LISTEN": f'["{endpoint}"]'}
    env.pop("STATE_DIRECTORY", None)
    start = ["make", "--old-file", f"{sys.prefix}/run", "run", f"VENV={sys.prefix}"]
    with socket.socket() as other:
        with suppress(OSError):  # somebody else may have it already
            other.bind(("127.0.0.1", 8080))
            other.listen()
        child = Child(["setsid", *start], env, cwd=REPOSITORY)
        try:
            child.wait_for_output(READY, 30)
            address = child.wait_for_output(LINK, 30).removeprefix(LINK)
            port = int(address.removeprefix("http://127.0.0.1:").partition("/")[0])
            assert port > 8080
            child.wait_for_output(f"Port 8080 is taken by another program, so the console listens on {port}.")
            assert child.stdout.splitlines()[-1].startswith(LINK)
            walk = child.wait_for_output("or, from the keyboard: ")
            assert walk.rstrip().endswith(f"bin/hexapod-gateway walk --connect {endpoint}")
            with Client(endpoint, timeout_s=5) as client:
                seen = frames(client)
                assert client.start_leg(3, 90, 45, 120).accepted
                seen.wait(lambda frame: frame.cause == "watchdog")
            told = subprocess.run([*COMMAND, "check"], env=env, capture_output=True, text=True, check=True).stdout
            assert "runs on a simulated controller, and is " in told
            assert "ok       black box" in told
            assert not re.search("^(failure|warning  (frames|black box|SPI))", told, re.MULTILINE), told
            assert told.splitlines()[-1].startswith("The simulated robot can be driven")
            command = [*COMMAND, "incidents", "show", "last"]
            assert "leg 3" in subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout
        finally:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGTERM)
            child.wait(20)
            child.close()
