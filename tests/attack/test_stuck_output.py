"""Nobody reads what the gateway says: its Stops come all the same, and so does its end."""

import json
import os
import pty
import select
import shlex
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import pytest

from gateway.client import Client
from gateway.host.log_writer import MAX_LINES_WAITING
from schemas import keys
from schemas.telemetry import Ack, Cause
from tests.support.closing import Closing
from tests.support.gateway_process import COMMAND, Gateway, free_port, write_settings
from tests.support.heard import frames
from tests.zenoh.test_metrics import read, value

ANSWER_S = 3.0
"""For an answer, or a Stop, that takes some milliseconds: without the fix, neither came at all."""


class Stuck(Closing):
    """Something to write to that nobody reads."""

    def __init__(self, ours: int, theirs: int, path: str) -> None:
        """`path` leads to the same as `theirs`."""
        self.path = path
        self._theirs = theirs
        self._reader = os.fdopen(ours, errors="replace")
        # An opening of its own: the one that the gateway gets must go on blocking.
        self._more = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)

    @classmethod
    def pipe(cls) -> Self:
        ours, theirs = os.pipe()
        return cls(ours, theirs, f"/proc/{os.getpid()}/fd/{theirs}")

    @classmethod
    def terminal(cls) -> Self:
        ours, theirs = pty.openpty()
        return cls(ours, theirs, os.ttyname(theirs))

    def close(self) -> None:
        self._let_go()
        self._reader.close()

    def fill(self) -> None:
        """To the last byte; a terminal passes some on by and by, and has room again."""
        while select.select([], [self._more], [], 0.05)[1]:
            for size in (4096, 1):
                with suppress(BlockingIOError):
                    while True:
                        os.write(self._more, b"." * size)

    def lines(self) -> Iterator[str]:
        """What is in it, until the gateway has ended."""
        self._let_go()
        yield from self._reader

    def _let_go(self) -> None:
        if self._theirs >= 0:
            os.close(self._theirs)
            os.close(self._more)
        self._theirs = -1


def unread(folder: Path, *, stdout: str, stderr: str, **sections: dict[str, Any]) -> Gateway:
    """A gateway whose output goes to these files."""
    settings = {"telemetry": {"frames": True}, **sections}
    redirected = ["sh", "-c", f'exec "$@" >{stdout} 2>{stderr}', "sh"]
    return Gateway(folder, settings, prefix=redirected, wait=False)


def client_of(gateway: Gateway) -> Client:
    """A client, once the gateway answers."""
    with Client(gateway.endpoint, timeout_s=20) as client:
        client.state()
    return Client(gateway.endpoint, timeout_s=ANSWER_S)


def check_stops_come(gateway: Gateway, client: Client) -> None:
    """The watchdog's, the emergency stop's, and those of the end, with exit code 0."""
    heard = frames(client)
    assert client.start_leg(3, 90, 45, 120).accepted
    assert not rejected(client).accepted
    heard.wait(lambda frame: frame.cause is Cause.WATCHDOG, timeout_s=ANSWER_S)
    assert client.estop().stop_frames == 6
    begun = time.monotonic()
    gateway.child.terminate()
    heard.wait(lambda frame: frame.cause is Cause.SHUTDOWN, count=6, timeout_s=ANSWER_S)
    assert gateway.child.wait(10) == 0
    assert time.monotonic() - begun < 1.5


def rejected(client: Client) -> Ack:
    """A command that is said in the log."""
    return client.ask(keys.leg_command(1), {"servos": []})


@pytest.mark.parametrize("full_before", [False, True])
@pytest.mark.parametrize("make", [Stuck.pipe, Stuck.terminal])
def test_whatever_nobody_reads_holds_no_stop(tmp_path: Path, make: Callable[[], Stuck], full_before: bool) -> None:
    """Nor its start, where nobody has read for long. A journal that is stuck: tests/box."""
    with make() as stuck:
        if full_before:
            stuck.fill()
        with unread(tmp_path, stdout=stuck.path, stderr=stuck.path) as gateway, client_of(gateway) as client:
            stuck.fill()
            check_stops_come(gateway, client)


def test_what_nobody_read_is_counted_in_the_log_and_in_the_metrics(tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    sections: dict[str, dict[str, Any]] = {
        "telemetry": {"metrics": address},
        "log": {"level": "debug"},  # the simulated controller says what each frame does
        "watchdog": {"repeats": 0},
    }
    with (
        Stuck.pipe() as stuck,
        unread(tmp_path, stdout=os.devnull, stderr=stuck.path, **sections) as gateway,
    ):
        with client_of(gateway) as client:
            stuck.fill()
            for _ in range(MAX_LINES_WAITING // 6 + 10):
                assert client.stop().accepted
            dropped = value(read(address), "hexapod_log_lines_dropped_total")
            assert dropped > 0
            lines = stuck.lines()
            said = next(json.loads(line)["message"] for line in lines if "dropped here" in line)
            assert said == f"{dropped:.0f} lines were dropped here, since they were not read in time"
            assert not rejected(client).accepted
            assert "command_rejected" in next(line for line in lines if "rejected" in line), "it flows again"
        gateway.child.terminate()
        assert any("stopping" in line for line in lines), "to the end"
        assert gateway.child.wait(10) == 0


def test_no_file_takes_the_place_of_a_closed_stderr(tmp_path: Path) -> None:
    """The next file that was opened would have its number: what is said there would go to the SPI device."""
    closed = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh"]
    with Gateway(tmp_path, prefix=closed, wait=False) as gateway, client_of(gateway):
        files = [os.readlink(f"/proc/{gateway.child.pid}/fd/{number}") for number in range(3)]
    assert files == [os.devnull] * 3


@pytest.mark.parametrize("tostop", ["tostop", "-tostop"])
def test_its_terminal_does_not_suspend_it(tmp_path: Path, tostop: str) -> None:
    """Neither one that suspends whoever writes to it from the background, nor Ctrl-Z."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = write_settings(tmp_path / "gateway.toml", {"zenoh": {"listen": [endpoint]}})
    command = shlex.join([*COMMAND, "run", "--sim", "--config", str(config)])
    ours, theirs = pty.openpty()
    shell = ["setsid", "--ctty", "bash", "-c", f'set -m; stty {tostop}; {command} & echo "number $!"; exec cat']
    with subprocess.Popen(shell, stdin=theirs, stdout=theirs, stderr=theirs) as terminal:
        os.close(theirs)
        said = b""

        def wait_for(word: bytes) -> None:
            nonlocal said
            while word not in said:
                assert select.select([ours], [], [], 20)[0], said
                said += os.read(ours, 4096)

        try:
            wait_for(b"is ready")
            number = int(said.partition(b"number ")[2].split()[0])
            os.kill(number, signal.SIGTSTP)
            with Client(endpoint, timeout_s=ANSWER_S) as client:
                assert client.estop().stop_frames == 6
            os.kill(number, signal.SIGTERM)
            wait_for(b"mode stopping")
        finally:
            terminal.kill()  # and the gateway with it, should it live
            os.close(ours)
