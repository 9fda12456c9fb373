"""Nobody reads what the gateway says: its Stops come all the same, and so does its end."""

import os
import pty
import select
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.client import Client
from schemas import keys
from schemas.telemetry import Cause
from tests.support.gateway_process import Gateway
from tests.support.heard import frames
from tests.support.waiting import Closing

ANSWER_S = 20.0
"""For an answer, or a Stop, that takes some milliseconds: without the fix, neither came at all."""


class Stuck(Closing):
    """Something to write to that nobody reads."""

    def __init__(self, make: Callable[[], tuple[int, int]]) -> None:
        self._ours, self._theirs = make()
        self.path = f"/proc/{os.getpid()}/fd/{self._theirs}"
        # An opening of its own: the one that the gateway gets must go on blocking.
        self._more = os.open(self.path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)

    def close(self) -> None:
        for descriptor in (self._theirs, self._more, self._ours):
            os.close(descriptor)

    def fill(self) -> None:
        """To the last byte; a terminal passes some on by and by, and has room again."""
        while select.select([], [self._more], [], 0.05)[1]:
            for size in (4096, 1):
                with suppress(BlockingIOError):
                    while True:
                        os.write(self._more, b"." * size)


@pytest.mark.parametrize("full_before", [False, True])
@pytest.mark.parametrize("make", [os.pipe, pty.openpty])
def test_whatever_nobody_reads_holds_no_stop(
    tmp_path: Path, make: Callable[[], tuple[int, int]], full_before: bool
) -> None:
    """The watchdog's, the emergency stop's, those of the end. Nor its start, where nobody has read for long.

    A journal that is stuck: tests/box.
    """
    with Stuck(make) as stuck:
        if full_before:
            stuck.fill()
        redirected = ["sh", "-c", f'exec "$@" >{stuck.path} 2>{stuck.path}', "sh"]
        settings = {"telemetry": {"frames": True}}
        with (
            Gateway(tmp_path, settings, prefix=redirected, wait=False) as gateway,
            Client(gateway.endpoint, timeout_s=ANSWER_S) as client,
        ):
            heard = frames(client)  # once the gateway answers
            stuck.fill()
            assert client.start_leg(3, 90, 45, 120).accepted
            assert not client.ask(keys.leg_command(1), {"servos": []}).accepted, "which is said in the log"
            heard.wait(lambda frame: frame.cause is Cause.WATCHDOG, timeout_s=ANSWER_S)
            assert client.estop().stop_frames == 6
            gateway.child.terminate()
            heard.wait(lambda frame: frame.cause is Cause.SHUTDOWN, count=6, timeout_s=ANSWER_S)
            assert gateway.child.wait() == 0
