"""Programs that hold the lease, on a real gateway: what their commands carry, how it ends, and whom they stop."""

from functools import partial

import pytest
import zenoh

from gateway.client import Client, LeaseLostError, RejectedError, leg_payload
from schemas import keys
from schemas.telemetry import Cause, Kind, Reason
from tests.support.fixtures import client_fixture, gateway_fixture, patient
from tests.support.gateway_process import Gateway
from tests.support.heard import events, frames, is_stop, running
from tests.support.waiting import wait_until

POSE = (90, 45, 120)

# For setpoints every 20 ms, on a machine that may be busy for longer than the watchdog's 250.
gateway = gateway_fixture(patient(1000, telemetry={"frames": True}))
anna = client_fixture("anna", rests=True)
bert = client_fixture("bert")


def test_a_stop_carries_no_token(anna: Client, bert: Client) -> None:
    """It needs none, and nothing about one can make it fail."""
    asked: dict[str, bytes] = {}

    def hear(query: zenoh.Query) -> None:
        asked[str(query.key_expr)] = query.payload.to_bytes() if query.payload else b""

    wanted = (keys.LEGS_COMMAND, keys.leg_command(1), keys.servo_command(21), keys.ESTOP)
    declared = [bert.session.declare_queryable(key, hear) for key in wanted]
    bert.state()
    with anna.lease():
        wait_until(lambda: anna.start_leg(1, *POSE).accepted and keys.leg_command(1) in asked, "she knows who listens")
        assert b'"lease"' in asked.pop(keys.leg_command(1))
        for stop in (anna.stop, partial(anna.stop, 1), partial(anna.servo, 21, "stop"), anna.estop):
            assert stop().accepted
        assert anna.reset().accepted
    assert set(asked) == {*wanted}
    assert not [payload for payload in asked.values() if b'"lease"' in payload]
    for each in declared:
        each.undeclare()


def test_what_was_published_after_a_loss_moves_nothing_though_nobody_drives(anna: Client, bert: Client) -> None:
    heard = events(bert)
    with anna.lease() as lease:
        assert anna.start_leg(1, *POSE).accepted
        with bert.lease(take=True):
            pass
        anna.publish(keys.leg_command(1), leg_payload("start", POSE))
        rejected = heard.wait(lambda event: event.key == keys.leg_command(1))
        assert (rejected.source, rejected.reason) == ("anna", Reason.NOT_HOLDER)
        assert running(bert) == []
        with pytest.raises(LeaseLostError):
            anna.start_leg(1, *POSE)
        assert lease.lost is not None
    assert anna.start_leg(1, *POSE).accepted, "outside it is a program that does nothing about leases"


def test_a_rejected_bystander_stops_nobody(gateway: Gateway, anna: Client, bert: Client) -> None:
    """One that gives up, and one that does not."""
    with gateway.client() as watcher, anna.lease(), anna.stream(50) as stream:
        happened, written = events(watcher), frames(watcher)
        stream.set({1: POSE, 2: POSE})
        with pytest.raises(RejectedError, match="anna holds the lease"), bert.stream(50) as rejected:
            rejected.set({1: POSE, 6: POSE})
        with bert.stream(50) as rejected:
            for _ in range(2):
                with pytest.raises(RejectedError, match="anna holds the lease"):
                    rejected.set({1: POSE, 6: POSE})
                rejected.start_again()
        for _ in range(10):
            stream.set({1: POSE, 2: POSE})
        assert running(watcher) == [1, 2]
        assert not [record for record in written.all if record.cause is Cause.COMMAND and is_stop(record)]
        assert not [event for event in happened.all if event.kind == Kind.SOURCE_CHANGED]
