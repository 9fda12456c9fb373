"""Runs our commands again and again without importing them again: each in a fork of a process that has them loaded.

    python -m tests.hil.forks          a JSON list of arguments a line: ["run", "--config", "gateway.toml"]

Each line of arguments is answered with the process id, `kill` ends the command that runs with SIGKILL, and `wait`
waits for its end; both are answered with its exit status, negative for a signal. What the commands print goes to
standard error.
"""

import importlib
import json
import os
import pkgutil
import signal
import sys
from collections.abc import Sequence

import gateway
from gateway import cli
from gateway.host import logs
from tests.hil.bed import SpiTestbed
from tests.support.child import Child


class Forks:
    """The test's end of it: one command at a time, on an emulated device."""

    def __init__(self, bed: SpiTestbed) -> None:
        self._child: Child = bed.spawn([sys.executable, "-m", "tests.hil.forks"])

    def start(self, *arguments: str) -> int:
        """Start `hexapod-gateway` with these; its process id."""
        return int(self._child.ask(json.dumps(arguments), timeout_s=30))

    def kill(self) -> int:
        """SIGKILL; its exit status."""
        return int(self._child.ask("kill"))

    def wait(self) -> int:
        """Wait for its end; its exit status."""
        return int(self._child.ask("wait", timeout_s=30))

    def __str__(self) -> str:
        return str(self._child)


def run(arguments: Sequence[str]) -> int:
    """In the fork: what the console script does."""
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.argv = ["hexapod-gateway", *arguments]
    try:
        cli.main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    finally:
        logs.close()  # which an interpreter that ends does by itself
    return 0


def main() -> None:
    for module in pkgutil.walk_packages(gateway.__path__, "gateway."):
        if not module.name.endswith("__main__") and ".ros2." not in module.name:  # the node needs ROS 2
            importlib.import_module(module.name)
    importlib.import_module("spidev")
    pid = 0
    for line in sys.stdin:
        match line.strip():
            case "kill":
                os.kill(pid, signal.SIGKILL)
                answer = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            case "wait":
                answer = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            case request:
                pid = os.fork()
                if pid == 0:
                    os._exit(run(json.loads(request)))
                answer = pid
        print(answer, flush=True)


if __name__ == "__main__":
    main()
