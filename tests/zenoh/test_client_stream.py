"""A gait's stream against a real gateway: what it sends, how it ends, and whose legs that end stops."""

import pytest

from gateway.client import Client, RejectedError
from gateway.model.frames import decode
from schemas.telemetry import Cause, FrameRecord, Kind
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events, frames, running

HZ = 50
POSE = (90, 45, 120)
TIMEOUT_MS = 1000
"""For setpoints every 20 ms, on a machine that may be busy for longer than the watchdog's 250."""


gateway = gateway_fixture(patient(TIMEOUT_MS, telemetry={"frames": True}))
watcher = client_fixture("somebody else", rests=True)
robot = client_fixture(None)
anna = client_fixture("anna", rests=True)
bert = client_fixture("bert")


# ---- whose legs the end of a stream stops: its own, also where nobody knows whether they run, and nobody else's


def stops(written: Heard[FrameRecord]) -> list[str]:
    """Stops that somebody commanded."""
    return [
        record.bytes
        for record in written.all
        if record.cause is Cause.COMMAND and decode(bytes.fromhex(record.bytes)).is_stop
    ]


def test_a_rejected_bystander_stops_nobody(gateway: Gateway, anna: Client, bert: Client) -> None:
    """One that gives up, and one that does not."""
    with gateway.client() as watcher, anna.lease(), anna.stream(HZ) as stream:
        happened, written = events(watcher), frames(watcher)
        stream.set({1: POSE, 2: POSE})
        with pytest.raises(RejectedError, match="anna holds the lease"), bert.stream(HZ) as rejected:
            rejected.set({1: POSE, 6: POSE})
        with bert.stream(HZ) as rejected:
            for _ in range(2):
                with pytest.raises(RejectedError, match="anna holds the lease"):
                    rejected.set({1: POSE, 6: POSE})
                rejected.start_again()
        for _ in range(10):
            stream.set({1: POSE, 2: POSE})
        assert running(watcher) == [1, 2]
        assert not stops(written)
        assert not [event for event in happened.all if event.kind == Kind.SOURCE_CHANGED]
