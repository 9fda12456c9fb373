"""Nobody reads what the gateway says: its Stops come all the same, and so does its end."""

import os
import pty
import select
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import pytest

from gateway.client import Client
from schemas import keys
from schemas.telemetry import Ack, Cause
from tests.support.closing import Closing
from tests.support.gateway_process import Gateway
from tests.support.heard import frames

ANSWER_S = 20.0
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
    gateway.child.terminate()
    heard.wait(lambda frame: frame.cause is Cause.SHUTDOWN, count=6, timeout_s=ANSWER_S)
    assert gateway.child.wait() == 0


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
