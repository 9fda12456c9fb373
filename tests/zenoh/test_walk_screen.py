"""The terminal that `walk` fills: as a person uses it, and where nobody reads it."""

import os
import pty
import re
import shlex
import shutil
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

import pytest

from gateway.client import Client
from schemas.telemetry import Mode
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import COMMAND, Gateway
from tests.support.heard import states
from tests.support.lacks import skip_where

pytestmark = [pytest.mark.full, pytest.mark.attended]

POLL_S: Final = 0.05
LATE_S: Final = 30.0
"""For what takes milliseconds on a machine that is not busy."""
_ENDED: Final = "ended with status"


class Terminal:
    """One command in a terminal of 80 columns and 24 rows; after it, `stty -a` says how it left the terminal.

    Without tmux the test is skipped or, in CI, fails in one line that names the package.
    """

    def __init__(self, folder: Path, program: str, endpoint: str) -> None:
        """One of our programs, with its options, which dials this endpoint."""
        skip_where("" if shutil.which("tmux") else "Debian package missing: tmux")
        self._socket = folder / "tmux"  # a path, so that no server of somebody else's is met
        options = folder / "tmux.conf"
        options.write_text('set -g default-terminal "screen-256color"\n')
        # tmux itself loses an exit status now and then.
        command = shlex.join([*COMMAND, *program.split(), "--connect", endpoint])
        script = f'{command}; echo "{_ENDED} $?"; stty -a; exec cat'
        size = ("-x", "80", "-y", "24")
        self._tmux("-f", str(options), "new-session", "-d", *size, shlex.join(["sh", "-c", script]))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        subprocess.run(["tmux", "-S", self._socket, "kill-server"], capture_output=True, check=False, timeout=LATE_S)

    def press(self, *keys: str) -> None:
        """Press keys: "Space", "r", "C-c"."""
        self._tmux("send-keys", *keys)

    def wait(self, *texts: str, timeout_s: float = LATE_S) -> str:
        """Wait until all of `texts` are on the screen; its words, of which wrapping parts none.

        Raises TimeoutError that shows the screen.
        """
        deadline = time.monotonic() + timeout_s
        while True:
            screen = self._tmux("capture-pane", "-p")
            words = " ".join(screen.split())
            if all(text in words for text in texts):
                return words
            if time.monotonic() > deadline:
                raise TimeoutError(f"waited {timeout_s} s for {texts}; on the screen:\n{screen}")
            time.sleep(POLL_S)

    def wait_for_end(self, timeout_s: float = LATE_S) -> int:
        """Wait until the command ends; its exit status."""
        found = re.search(rf"{_ENDED} (\d+)", self.wait(f"{_ENDED} ", timeout_s=timeout_s))
        assert found is not None
        return int(found[1])

    def _tmux(self, *arguments: str) -> str:
        command = ["tmux", "-u", "-S", str(self._socket), *arguments]
        env = {**os.environ, "LC_ALL": "C.UTF-8"}
        env.pop("TMUX", None)
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=LATE_S, env=env).stdout


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
