"""Programs that hold the lease, on a real gateway: what their commands carry, and how it ends."""

import time
from functools import partial

import pytest
import zenoh

from gateway.client import Client, LeaseLostError, leg_payload
from schemas import keys
from schemas.telemetry import Reason
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.heard import events, running

POSE = (90, 45, 120)
LATE_S = 10

gateway = gateway_fixture({"watchdog": {"timeout_ms": 1000}})
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
        give_up_s = time.monotonic() + LATE_S
        while keys.leg_command(1) not in asked and time.monotonic() < give_up_s:  # until she knows who listens
            assert anna.start_leg(1, *POSE).accepted
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
