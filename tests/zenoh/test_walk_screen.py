"""The terminal that `walk` fills: stuck, too small for UTF-8, or none at all."""

import os
import pty
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import pytest

from schemas.telemetry import Mode
from tests.support.fixtures import gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import states
from tests.support.tmux import LATE_S

pytestmark = [pytest.mark.full, pytest.mark.attended]

gateway = gateway_fixture(patient(10_000))


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
