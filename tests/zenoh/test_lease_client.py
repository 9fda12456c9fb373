"""Programs that hold the lease, on a real gateway: what their commands carry, and how it ends."""

import threading
import time
from functools import partial

import pytest
import zenoh

from gateway.client import Client, LeaseLostError, Stream, leg_payload
from gateway.model.frames import decode
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Kind, Reason
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.heard import events, frames, is_stop, running, states

POSE = (90, 45, 120)
LATE_S = 10
HZ = 50
TTL_MS = 600.0


gateway = gateway_fixture(
    {
        "telemetry": {"frames": True},
        "lease": {"ttl_ms": TTL_MS},
        "watchdog": {"timeout_ms": 1000},
    }
)


anna = client_fixture("anna", rests=True)
bert = client_fixture("bert")


def walk_on(stream: Stream) -> None:
    for _ in range(LATE_S * HZ):
        stream.set({1: POSE, 4: POSE})


def test_inside_every_command_counts_and_nobody_elses(anna: Client, bert: Client) -> None:
    heard = events(bert)
    with anna.lease() as lease:
        assert (lease.holder, lease.verified, lease.ttl_ms) == ("anna", False, TTL_MS)
        assert anna.start_leg(1, *POSE).accepted
        assert anna.servo(11, "set", 91).accepted
        for ack in (bert.start_leg(2, *POSE), bert.set_leg(1, *POSE), bert.servo(11, "set", 1)):
            assert (ack.accepted, ack.reason) == (False, Reason.NOT_HOLDER)
            assert "anna" in (ack.detail or "")
        bert.publish(keys.leg_command(1), leg_payload("set", POSE))
        heard.wait(lambda event: event.kind == Kind.COMMAND_REJECTED and event.key == keys.leg_command(1), count=2)
        anna.publish(keys.leg_command(1), leg_payload("set", (12, 45, 120)))
        states(anna).wait(lambda state: state.legs[0].servos[0].angle_deg == 12)
        with anna.stream(HZ) as stream:
            for _ in range(3):
                stream.set({2: POSE})
        assert anna.estop().accepted
        assert bert.reset().reason == Reason.NOT_HOLDER
        assert anna.reset().accepted
    assert bert.start_leg(2, *POSE).accepted


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


def test_a_forced_take_stops_all_legs_and_ends_the_other_ones_gait(anna: Client, bert: Client) -> None:
    lost: list[LeaseLostError] = []
    told = threading.Event()

    def on_lost(error: LeaseLostError) -> None:
        lost.append(error)
        told.set()

    with anna.lease(on_lost=on_lost), anna.stream(HZ) as stream:
        stream.set({1: POSE, 4: POSE})
        written = frames(bert)
        with bert.lease(take=True):
            written.wait(is_stop, count=len(LEGS))
            assert {decode(bytes.fromhex(frame.bytes)).servos[0][0] // 10 for frame in written.all} == {*LEGS}
            with pytest.raises(LeaseLostError, match="bert") as caught:
                walk_on(stream)
            assert caught.value.holder == "bert"
            with pytest.raises(LeaseLostError):
                stream.set({1: POSE})
            with pytest.raises(LeaseLostError):
                anna.start_leg(1, *POSE)
            assert told.wait(LATE_S)
            assert anna.servo(11, "stop").accepted
            assert anna.stop().accepted
            assert anna.estop().accepted
            assert bert.reset().accepted
            assert bert.start_leg(1, *POSE).accepted
            stream.close()
            assert running(bert) == [1], "it is not anna's any more"
    assert len(lost) == 1


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
