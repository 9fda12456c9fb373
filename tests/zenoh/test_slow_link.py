"""A leg that somebody stops while a robot walks over a slow link: the other five keep running."""

from pathlib import Path

import pytest

from gateway.client import Client, Walk
from gateway.errors import StoppedError
from schemas.telemetry import Kind
from tests.support.cut_link import CutLink
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway
from tests.support.heard import events, running

WATCHDOG_MS = 1500
DELAY_S = 0.3
"""In each direction. A client that asks twice before it goes on is silent for longer than the watchdog waits."""


def walks_on(walk: Walk) -> None:
    while True:
        walk.go(forward_m_s=0.03)


def test_the_other_legs_of_a_walk_keep_running(tmp_path: Path) -> None:
    with (
        Gateway(tmp_path, patient(WATCHDOG_MS)) as gateway,
        CutLink(gateway.endpoint, DELAY_S) as link,
        Client(gateway.endpoint, source="watcher") as watcher,
        Client(link.endpoint, source="walker", timeout_s=10) as robot,
        robot.walk() as walk,
    ):
        happened = events(watcher)
        walk.stand()
        watcher.stop(3)
        with pytest.raises(StoppedError, match="watcher stopped leg 3") as stopped:
            walks_on(walk)
        assert stopped.value.legs == (3,)
        answered = robot.state(), robot.state()  # twice the way there and back, longer than the watchdog's timeout
        assert [leg.leg for leg in answered[-1].legs if leg.running] == [1, 2, 4, 5, 6]
        assert running(watcher) == [1, 2, 4, 5, 6]
        assert Kind.WATCHDOG_EXPIRED not in [event.kind for event in happened.all]
