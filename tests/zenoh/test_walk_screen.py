"""The terminal that `walk` fills: as a person uses it, and where nobody reads it."""

import os
import pty
import re
import select
import subprocess
import termios
import time
from contextlib import suppress
from pathlib import Path
from typing import Final

import pytest

from gateway.client import Client
from gateway.people.commands.walk import screen
from schemas.words import Mode
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import states
from tests.support.waiting import Closing, wait_until

pytestmark = [pytest.mark.full, pytest.mark.attended]

LATE_S: Final = 30.0
"""For what takes milliseconds on a machine that is not busy."""
STEERING: Final = re.compile(rb"\x1b\[[0-9;?]*[A-Za-z]")


class Terminal(Closing):
    """`walk` in a terminal of 80 columns and 24 rows. What it draws waits there until it is read."""

    def __init__(self, endpoint: str) -> None:
        self.end, slave = pty.openpty()
        termios.tcsetwinsize(slave, (24, 80))
        command = [*COMMAND, "walk", "--connect", endpoint]
        self.process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave)
        os.close(slave)

    def press(self, keys: str) -> None:
        os.write(self.end, keys.encode())

    def wait(self, *texts: str) -> None:
        """Read until all of `texts` have been drawn anew. Raises TimeoutError."""
        drawn, end_s = b"", time.monotonic() + LATE_S
        while not all(
            text in (words := b" ".join(STEERING.sub(b"", drawn).split()).decode(errors="replace")) for text in texts
        ):
            if not select.select([self.end], [], [], max(0.0, end_s - time.monotonic()))[0]:
                raise TimeoutError(f"waited {LATE_S} s for {texts}, and saw {words}")
            drawn += os.read(self.end, 4096)

    def wait_for_end(self) -> int:
        """Read until the command ends, and return its exit status."""
        with suppress(OSError):  # as Linux reports the end
            while os.read(self.end, 4096):
                pass
        return self.process.wait(LATE_S)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.end)


gateway = gateway_fixture(patient(10_000))
watcher = client_fixture("watcher")


def test_no_line_of_keys_wraps_in_80_columns() -> None:
    assert max(map(len, screen._KEYS.splitlines())) <= 80


def test_a_person_walks_stops_goes_on_also_after_a_takeover_and_leaves(gateway: Gateway, watcher: Client) -> None:
    with Terminal(gateway.endpoint) as terminal:
        terminal.wait("Nothing moves before you press a key.", "drives", "It lies")
        assert watcher.state().mode == Mode.IDLE
        terminal.press("t")
        terminal.wait("It stands")
        terminal.press("2w")
        terminal.wait("It walks ripple")
        terminal.wait("It stands")  # a key that is released
        terminal.press(" ")
        terminal.wait("STOPPED: 6 Stop frames written within")
        assert watcher.state().mode == Mode.ESTOPPED
        terminal.press("w")
        terminal.wait("g goes on", "nothing runs until a reset")
        terminal.press("g")
        terminal.wait("It goes on with the next key.", "It lies")
        assert watcher.state().mode == Mode.IDLE
        with watcher.lease(take=True, source="anna"):
            terminal.press("t")
            terminal.wait("anna holds it now; g goes on", "does not drive")
        terminal.press("g")
        terminal.wait("It goes on with the next key.", "drives")
        terminal.press("t")
        terminal.wait("It stands")
        terminal.press("c")
        terminal.wait("It sits")
        terminal.press("q")
        assert terminal.wait_for_end() == 0
    assert watcher.state().mode == Mode.IDLE
    assert watcher.state().lease.holder is None


def test_the_stop_key_and_the_end_work_when_the_terminal_takes_no_more(gateway: Gateway, watcher: Client) -> None:
    """A terminal that nobody reads: drawing blocks in the middle of a picture, and the key still stops the robot."""
    seen = states(watcher)
    with Terminal(gateway.endpoint) as terminal:
        # Its first bytes say that keys come one by one now; the rest stays unread, and fills the pty's 4 KB.
        assert os.read(terminal.end, 1)
        wait_until(lambda: is_stuck(terminal.process.pid), "its drawing blocks")
        terminal.press(" ")
        seen.wait(lambda state: state.mode is Mode.ESTOPPED)
        wait_until(lambda: ends_at_ctrl_c(terminal), "its end")


def ends_at_ctrl_c(terminal: Terminal) -> bool:
    """Return whether Ctrl-C ends it; one that is read together with the stop does not count."""
    terminal.press("\x03")
    with suppress(subprocess.TimeoutExpired):
        terminal.process.wait(0.2)
    return terminal.process.returncode is not None


def is_stuck(pid: int) -> bool:
    """Return whether a thread of the process waits in the terminal's write, by its kernel stack or wait channel."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has ended meanwhile
            number, descriptor = [*(task / "syscall").read_text(encoding="ascii").split(), "", ""][:2]
            if number == str(_WRITE) and int(descriptor, 16) == 1:
                return True
    return False


_WRITE = {"x86_64": 1, "aarch64": 64}.get(os.uname().machine, 1)
