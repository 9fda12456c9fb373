"""A gait's stream whose SPI device fails under it."""

import errno
from pathlib import Path

import pytest

from gateway.client import RejectedError, StoppedError
from schemas.telemetry import Kind
from tests.hil.wire import Wire, start
from tests.support.heard import events, running
from tests.zenoh.test_client_stream import HZ, POSE, go_on

pytestmark = pytest.mark.hil


def test_a_fault_of_the_bus_ends_it_and_nothing_moves_by_itself(tmp_path: Path, wire: Wire) -> None:
    with (
        start(tmp_path, wire, watchdog={"timeout_ms": 1000}) as gateway,
        gateway.client() as robot,
        gateway.client() as watcher,
    ):
        happened = events(watcher)
        with robot.stream(HZ) as stream:
            stream.set({3: POSE})
            wire.bed.fail(errno.EIO, count=1)
            with pytest.raises((StoppedError, RejectedError)):
                go_on(stream, 3)
            happened.wait(lambda event: event.kind is Kind.BUS_RECOVERED)
            assert running(watcher) == []
            with pytest.raises(StoppedError):
                go_on(stream, 3)
            assert running(watcher) == []
            stream.start_again()
            stream.set({3: POSE})
            assert running(watcher) == [3]
        assert running(watcher) == []
