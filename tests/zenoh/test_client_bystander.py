"""Whose legs the end of a stream stops: its own, also where nobody knows whether they run, and nobody else's."""

import pytest

from gateway.client import Client, DisconnectedError, RejectedError, StoppedError, Stream
from gateway.people.tools.drill.cut_link import CutLink
from gateway.robot.protocol.frames import decode
from schemas.telemetry import Cause, FrameRecord, Kind
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events, frames, running
from tests.zenoh.test_client_stream import HZ, POSE, go_on

Angles = dict[int, tuple[float, float, float]]


gateway = gateway_fixture(patient(1000, telemetry={"frames": True}))
anna = client_fixture("anna", rests=True)
bert = client_fixture("bert")


def stops(written: Heard[FrameRecord]) -> list[str]:
    """Stops that somebody commanded."""
    return [
        record.bytes
        for record in written.all
        if record.cause is Cause.COMMAND and decode(bytes.fromhex(record.bytes)).is_stop
    ]


def both_go_on(ends: Stream, its: Angles, goes_on: Stream, others: Angles) -> None:
    """Set both, until the first raises; for ten seconds at most."""
    for _ in range(10 * HZ):
        ends.set(its)
        goes_on.set(others)


def test_a_rejected_bystander_stops_nobody(gateway: Gateway, anna: Client, bert: Client) -> None:
    """One that gives up, and one that does not."""
    with gateway.client() as watcher, anna.lease(), anna.stream(HZ) as stream:
        happened, written = events(watcher), frames(watcher)
        stream.set({1: POSE, 2: POSE})
        with pytest.raises(RejectedError, match="anna holds the lease"), bert.stream(HZ) as rejected:
            rejected.set({1: POSE, 6: POSE})
        with bert.stream(HZ) as rejected:
            for _ in range(3):
                with pytest.raises(RejectedError, match="anna holds the lease"):
                    rejected.set({1: POSE, 6: POSE})
                rejected.start_again()
        for _ in range(10):
            stream.set({1: POSE, 2: POSE})
        assert running(watcher) == [1, 2]
        assert not stops(written)
        assert not [event for event in happened.all if event.kind == Kind.SOURCE_CHANGED]


def test_who_drove_before_a_takeover_stops_nothing_of_the_new_holder(anna: Client, bert: Client) -> None:
    """Without a lease of its own: the takeover stopped its legs, and what runs now is the holder's."""
    with bert.stream(HZ) as before:
        before.set({1: POSE, 2: POSE})
        with anna.lease(take=True), anna.stream(HZ) as stream:
            stream.set({1: POSE, 3: POSE})
            with pytest.raises((RejectedError, StoppedError)):
                both_go_on(before, {1: POSE, 2: POSE}, stream, {1: POSE, 3: POSE})
            before.close()
            for _ in range(10):
                stream.set({1: POSE, 3: POSE})
            assert running(anna) == [1, 3]


def test_who_is_rejected_while_its_own_legs_run_stops_them(anna: Client, bert: Client) -> None:
    """Somebody acquires the lease while it was free: nothing was stopped, and the legs are still this program's."""
    with anna.stream(HZ) as other, bert.stream(HZ) as stream:
        other.set({4: POSE})
        stream.set({1: POSE})
        with anna.lease():
            with pytest.raises(RejectedError, match="anna holds the lease"):
                both_go_on(stream, {1: POSE}, other, {4: POSE})
            assert 1 in running(anna)
            stream.close()
            assert running(anna) == [4]


def test_a_start_that_nobody_answered_is_stopped(gateway: Gateway, anna: Client) -> None:
    """It may still be on its way, and arrive later."""
    written = frames(anna)
    with CutLink(gateway.endpoint) as link, Client(link.endpoint, source="bert", timeout_s=0.3) as bert:
        with bert.stream(HZ) as stream:
            link.hold()
            with pytest.raises(DisconnectedError):
                stream.set({5: POSE})
            link.fix()
            written.wait(lambda record: record.cause is Cause.COMMAND)
        assert running(anna) == []
    assert len(stops(written)) == 1


def test_a_leg_that_somebody_else_stopped_and_started_is_theirs(anna: Client, bert: Client) -> None:
    with bert.stream(HZ) as stream:
        stream.set({1: POSE, 2: POSE})
        assert anna.stop(1).accepted
        with pytest.raises(StoppedError, match="leg 1"):
            go_on(stream, 1, 2)
        assert anna.start_leg(1, *POSE).accepted
    assert running(anna) == [1]
