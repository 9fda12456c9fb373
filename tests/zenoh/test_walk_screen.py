"""The terminal that `walk` fills: as a person uses it, and where nobody reads it."""

import os
import pty
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.client import Client
from schemas.telemetry import Mode
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import states
from tests.support.tmux import LATE_S, Terminal

pytestmark = [pytest.mark.full, pytest.mark.attended]

gateway = gateway_fixture(patient(10_000))
watcher = client_fixture("watcher")


def test_a_person_walks_stops_and_leaves(tmp_path: Path, gateway: Gateway, watcher: Client) -> None:
    with Terminal(tmp_path, "walk", gateway.endpoint) as terminal:
        terminal.wait("Nothing moves before you press a key.", "drives", "It lies")
        assert watcher.state().mode == Mode.IDLE
        terminal.press("t")
        terminal.wait("It stands")
        terminal.press("2")
        terminal.press("w")
        terminal.wait("It walks ripple")
        terminal.wait("It stands")  # a key that is released
        terminal.press("Space")
        terminal.wait("STOPPED: 6 Stop frames written within")
        assert watcher.state().mode == Mode.ESTOPPED
        terminal.press("w")
        terminal.wait("g goes on", "nothing runs until a reset")
        terminal.press("g")
        terminal.wait("It goes on with the next key.", "It lies")
        assert watcher.state().mode == Mode.IDLE
        terminal.press("c")
        terminal.wait("It sits")
        terminal.press("q")
        assert terminal.wait_for_end(60) == 0
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None


def test_the_stop_key_works_when_the_terminal_takes_no_more_and_so_does_the_end(gateway: Gateway) -> None:
    """A terminal that nobody reads: drawing blocks in the middle of a picture, and the key still stops the robot."""
    master, slave = pty.openpty()
    os.set_blocking(master, True)
    with gateway.client() as client:
        seen = states(client)
        command = [*COMMAND, "walk", "--connect", gateway.endpoint]
        shown = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave)
        try:
            os.close(slave)
            # Its first bytes say that keys come one by one now; the rest stays unread, and fills the pty's 4 KB.
            assert os.read(master, 1)
            wait_for_stuck_writer(shown.pid)
            os.write(master, b" ")
            seen.wait(lambda state: state.mode is Mode.ESTOPPED)
            deadline = time.monotonic() + LATE_S
            while shown.poll() is None and time.monotonic() < deadline:
                os.write(master, b"\x03")  # Ctrl-C; one that is read together with the stop does not count
                with suppress(subprocess.TimeoutExpired):
                    shown.wait(0.2)
            assert shown.returncode is not None
        finally:
            shown.kill()
            shown.wait()
            os.close(master)


def wait_for_stuck_writer(pid: int) -> None:
    """Until a thread of the process waits in the terminal's write, as its kernel stack or wait channel says."""
    deadline = time.monotonic() + LATE_S
    while time.monotonic() < deadline:
        for task in Path(f"/proc/{pid}/task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has ended meanwhile
                number, descriptor = [*(task / "syscall").read_text(encoding="ascii").split(), "", ""][:2]
                if number == str(_WRITE) and int(descriptor, 16) == 1:
                    return
        time.sleep(0.05)
    raise TimeoutError("its drawing never blocked")


_WRITE = {"x86_64": 1, "aarch64": 64}.get(os.uname().machine, 1)
