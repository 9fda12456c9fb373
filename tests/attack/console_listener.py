"""A console on TLS on a robot, a page on one laptop, strangers on another: how soon is STOP ALL confirmed?

`python -m tests.attack.console_listener` prints the table of docs/security.md. It needs root, for network namespaces.
"""

import json
import os
import statistics
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final

from gateway import certs
from gateway.people.console.server.sessions import Sessions
from tests.benchmarks.processes import rss_kb, threads
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
FLOODS: Final = (("pings", 1), ("pings", 8), ("pongs", 4), ("fragments", 4), ("messages", 8))
"""What pages that are signed in do, and how many of them."""


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

    @contextmanager
    def flooded(self, kind: str, count: int) -> Iterator[list[Child]]:
        """Pages that are signed in are at it."""
        url = f"https://{self.network.robot_address(STRANGERS)}:{PORT}"
        program = [sys.executable, "-m", "tests.attack.flooding_page", kind, url, *self.page.session]
        children = [Child([*self.network.laptop(STRANGERS), *program], os.environ) for _ in range(count)]
        try:
            for child in children:
                child.wait_for_output("ended", 20)
            yield children
        finally:
            for child in children:
                child.close()

    def close(self) -> None:
        self._stack.close()


def row(what: str, quiet_ms: Sequence[float], attacked_ms: Sequence[float]) -> str:
    """One line of the table."""
    return (
        "| "
        + " | ".join((what, *(f"{value:.0f}" for each in (quiet_ms, attacked_ms) for value in spread(each))))
        + " |"
    )


def spread(took_ms: Sequence[float]) -> tuple[float, float]:
    """The median, and the worst."""
    return statistics.median(took_ms), max(took_ms)


def main() -> None:
    """Print the table: of all, or of the kinds that are named."""
    wanted = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder, ListenerStand(Path(folder)) as stand:
        stand.press(10)
        for cases, attack in ((CASES, stand.attacked), (FLOODS, stand.flooded)):
            for kind, count in cases:
                if wanted and kind not in wanted:
                    continue
                quiet_ms = stand.press()
                with attack(kind, count):
                    print(row(f"{kind}, {count}", quiet_ms, stand.press()), flush=True)
        pid = stand.console.pid
        print(f"{rss_kb(pid) / 1024:.0f} MB, {threads(pid)} threads")


if __name__ == "__main__":
    main()
