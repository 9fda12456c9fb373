"""The two that are compared, each as a process on an emulated SPI device of its own, and their publishers."""

import os
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from gateway.client import Client
from tests.benchmarks.processes import OnDevice, Written
from tests.benchmarks.publisher import number_of, read_log
from tests.support.child import Child
from tests.support.gateway_process import COMMAND, READY, free_port, write_settings

SETTLE_S = 0.3
"""After a round: what is still under way arrives, and the gateway's watchdog has stopped the legs."""


def program(name: str, *arguments: str) -> Child:
    """Another program of the benchmark, in a process of its own."""
    return Child([sys.executable, "-m", f"tests.benchmarks.{name}", *arguments], os.environ)


class Subject:
    """One of the two, running."""

    def __init__(
        self,
        name: str,
        folder: Path,
        stack: ExitStack,
        prefix: tuple[str, ...] = (),
    ):
        """`prefix` goes before the gateway's command."""
        self.name = name
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._folder = folder
        self._stack = stack
        self._publishers = 0
        if name == "gateway":
            config = write_settings(
                folder / "gateway.toml", {"zenoh": {"listen": [self.endpoint]}, "spi": {"framing": "plain"}}
            )
            command, ready = [*prefix, *COMMAND, "run", "--config", str(config)], READY
        else:
            command, ready = [sys.executable, "-m", "tests.benchmarks.naive", self.endpoint], "ready"
        self.device = stack.enter_context(OnDevice(command, folder / f"{name}.log", ready=ready))

    @property
    def pid(self) -> int:
        return self.device.pid

    def client(self) -> Client:
        """A client in this process."""
        return self._stack.enter_context(Client(self.endpoint, timeout_s=5))

    def publisher(self, *arguments: str) -> "Publisher":
        """A publisher for it, connected, in a process of its own."""
        self._publishers += 1
        log = self._folder / f"{self.name}-{self._publishers}.published"
        publisher = Publisher(self.endpoint, log, arguments)
        self._stack.callback(publisher.child.close)
        return publisher


class Publisher:
    """A publisher at work."""

    def __init__(self, endpoint: str, log: Path, arguments: tuple[str, ...]) -> None:
        self._log = log
        self.child = program("publisher", endpoint, "--log", str(log), *arguments)
        self.child.wait_for_output("ready", timeout_s=20)
        self._runs = 0

    def start(self, duration_s: float) -> None:
        """Publish for that long."""
        self._runs += 1
        self.child.tell(str(duration_s))

    def wait(self, timeout_s: float = 60) -> int:
        """Wait until that is done; how many messages it were."""
        return int(self.child.wait_for_line(self._runs, timeout_s).split()[1])

    def run(self, duration_s: float) -> int:
        """Publish for that long, and let what is under way arrive."""
        self.start(duration_s)
        count = self.wait(duration_s + 60)
        time.sleep(SETTLE_S)
        return count

    def latencies_ns(self, written: list[Written]) -> list[int]:
        """Published → transferred, of those of its messages that were transferred."""
        published = read_log(self._log)
        found = []
        for transfer in written:
            number = number_of(transfer.data)
            if number in published:
                found.append(transfer.monotonic_ns - published[number])
        return found
