"""A console on TLS on a robot, a page on one laptop, strangers on another: how soon is STOP ALL confirmed?"""

import json
import os
import statistics
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

from gateway import certs
from gateway.people.console.server.sessions import Sessions
from tests.net.namespaces import Network
from tests.support.child import Child
from tests.support.closing import Closing
from tests.support.console_process import LINK, SignedIn
from tests.support.gateway_process import COMMAND, Gateway

PORT: Final = 8443
GATEWAY: Final = "tcp/127.0.0.1:7447"
PRESSES: Final = 50
PAGE, STRANGERS = 0, 1
"""The laptops."""
CASES: Final = (
    ("chunked", 5),
    ("chunked", 20),
    ("body", 40),
    ("silent", 700),
    ("half_open", 700),
    ("handshake", 50),
    ("slow_headers", 200),
    ("huge_headers", 50),
    ("get", 50),
    ("link", 20),
    ("upgrade", 50),
    ("garbage", 100),
)
"""What strangers do, and on how many connections at once."""


class PagePresses(Closing):
    """A page that is signed in, on a laptop."""

    def __init__(self, laptop: Sequence[str], link: str, authority: Path) -> None:
        """`laptop` goes before its command."""
        self.child = Child([*laptop, sys.executable, "-m", "tests.attack.presses", link, str(authority)], os.environ)
        try:
            said = self.child.wait_for_output("signed in", 30)
        except BaseException:
            self.child.close()
            raise
        self.session = SignedIn(*json.loads(said.removeprefix("signed in ")))

    def press(self, times: int) -> list[float]:
        """How long each took, in ms."""
        return [float(each) for each in json.loads(self.child.ask(str(times), 120))]

    def close(self) -> None:
        self.child.close()


@contextmanager
def strangers(kind: str, host: str, port: int, count: int, *plain: str, prefix: Sequence[str] = ()) -> Iterator[Child]:
    """Connections without a session, so many at once; `prefix` goes before the command."""
    program = [sys.executable, "-m", "tests.attack.strangers", kind, host, str(port), str(count), *plain]
    child = Child([*prefix, *program], os.environ)
    try:
        child.wait_for_output("made ", 20)
        yield child
    finally:
        child.kill()
        child.close()


class ListenerStand(Closing):
    """The robot with gateway and console, and a page that is signed in."""

    def __init__(self, folder: Path, prefix: Sequence[str] = ()) -> None:
        """`prefix` goes before the console's command."""
        with ExitStack() as stack:
            self.network = stack.enter_context(Network(laptops=2))
            hosts = [self.network.robot_address(laptop) for laptop in self.network.laptops]
            certs.folder.init(folder / "certs", hosts)
            certs.folder.issue(folder / "certs", "web", "console", hosts=hosts)
            self.folder = folder
            self.gateway = stack.enter_context(
                Gateway(folder, {"zenoh": {"listen": [GATEWAY]}}, prefix=self.network.robot)
            )
            files = [f"--cert={folder}/certs/web.pem", f"--key={folder}/certs/web.key"]
            command = [*COMMAND, "console", "--listen", f"0.0.0.0:{PORT}", *files, "--connect", GATEWAY]
            self.console = Child(
                [*self.network.robot, *prefix, *command], {**os.environ, "STATE_DIRECTORY": str(folder)}
            )
            stack.callback(self.console.close)
            self.console.wait_for_output(LINK, 20)
            self.page = stack.enter_context(self.another_page())
            self._stack = stack.pop_all()

    def another_page(self) -> PagePresses:
        """One more, on the same laptop."""
        link = Sessions(self.folder, PORT).new_link()
        return PagePresses(self.network.laptop(PAGE), link, self.folder / "certs" / "web-ca.pem")

    def press(self, times: int = PRESSES) -> list[float]:
        """How long each took, in ms."""
        return self.page.press(times)

    @contextmanager
    def attacked(self, kind: str, count: int) -> Iterator[Child]:
        """Strangers are at it."""
        address = self.network.robot_address(STRANGERS)
        with strangers(kind, address, PORT, count, prefix=self.network.laptop(STRANGERS)) as child:
            yield child

    def close(self) -> None:
        self._stack.close()


def spread(took_ms: Sequence[float]) -> tuple[float, float]:
    """The median, and the worst."""
    return statistics.median(took_ms), max(took_ms)
