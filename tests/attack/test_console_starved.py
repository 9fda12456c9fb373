"""A console without descriptors, whose stderr nobody reads: a press of STOP ALL arrives."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.people.console.server.sessions import Sessions
from tests.attack.strangers import strangers
from tests.support.closing import Closing
from tests.support.console_process import Page, sign_in
from tests.support.gateway_process import COMMAND, Gateway, free_port

pytestmark = [pytest.mark.full, pytest.mark.alone]

LATE_S = 60


class BareConsole(Closing):
    """A console without anybody who reads what it writes: both pipes are full from the beginning."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}"
        self._folder = folder
        self._read, write = os.pipe()
        os.set_blocking(write, False)
        try:
            while True:
                os.write(write, bytes(4096))
        except BlockingIOError:
            os.set_blocking(write, True)
        command = [*COMMAND, "console", "--listen", f"127.0.0.1:{self.port}", "--connect", endpoint]
        self._popen = subprocess.Popen(
            command,
            env={**os.environ, "STATE_DIRECTORY": str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=write,
            stderr=write,
        )
        os.close(write)
        self.pid = self._popen.pid
        try:
            self._wait()
        except BaseException:
            self.close()
            raise

    def page(self) -> Page:
        """A page that is signed in."""
        session = sign_in(Sessions(self._folder, self.port).new_link())
        return Page(self.url, session)

    def _wait(self) -> None:
        """Until it listens, and has written where links are made."""
        made = self._folder / f"console-{self.port}.json"
        program = (
            "import os, socket\n"
            f"while socket.socket().connect_ex(('127.0.0.1', {self.port})) or not os.path.exists({str(made)!r}): pass"
        )
        subprocess.run([sys.executable, "-c", program], check=True, timeout=20)

    def use_up_descriptors(self) -> None:
        """From now on it can open nothing, unless it closes something."""
        taken = {int(name) for name in os.listdir(f"/proc/{self.pid}/fd")}
        free = min(set(range(1000)) - taken)
        resource.prlimit(self.pid, resource.RLIMIT_NOFILE, (free, free))

    def close(self) -> None:
        """Kill it."""
        self._popen.kill()
        self._popen.wait(5)
        os.close(self._read)


def confirmed(page: Page, number: int) -> bool:
    """Wait until that press is confirmed."""
    found = page.wait("stop", lambda message: message["id"] == number and message["answered"], LATE_S)
    return bool(found["stop_frames"] == 6)


def test_without_descriptors_and_with_the_link_lost(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    listens = {"zenoh": {"listen": [endpoint]}}
    with BareConsole(tmp_path, endpoint) as console, Gateway(tmp_path, listens) as gateway, console.page() as page:
        page.wait("link", lambda message: message["status"] == "connected", LATE_S)
        console.use_up_descriptors()
        with strangers("slow_headers", console.port, 100, "plain"):
            gateway.child.kill()
            page.wait("link", lambda message: message["status"] == "gone", LATE_S)
            page.send(type="stop_all", id=1)
            assert not page.wait("stop")["answered"]
            with Gateway(tmp_path, listens):
                assert confirmed(page, 1)
