"""Who uses somebody else's name, or many names, neither gets them rejected nor lets their old commands in."""

import time

import pytest

from gateway.client import Client, leg_payload
from gateway.robot.core.staleness import SOURCES
from schemas import keys
from schemas.telemetry import Reason
from tests.support.fixtures import client_fixture, gateway_fixture

START = leg_payload("start", (90, 45, 120))
DAY_MS = 86_400_000.0


gateway = gateway_fixture({"limits": {"max_age_ms": 500}}, scope="function")
owner = client_fixture("owner")
forger = client_fixture(None)


def forge(client: Client, source: str, ahead_ms: float, *, op: str = "stop") -> bool:
    """A command in somebody's name, sent at another time than now. Whether it is accepted."""
    command = leg_payload(op, (90, 45, 120) if op != "stop" else ())
    payload = {**command, "source": source, "sent_ms": time.monotonic() * 1000 + ahead_ms}
    return client.ask(keys.leg_command(6), payload).accepted


@pytest.mark.parametrize("ahead_ms", [600, 5000, DAY_MS])
def test_a_forged_source_does_not_get_its_owner_rejected(owner: Client, forger: Client, ahead_ms: float) -> None:
    assert owner.start_leg(1, 90, 45, 120).accepted
    for _ in range(3):
        assert forge(forger, "owner", ahead_ms)
        assert forge(forger, "owner", ahead_ms, op="start")
        for _ in range(5):
            ack = owner.start_leg(1, 90, 45, 120)
            assert ack.accepted, ack.detail


def test_a_forged_clock_does_not_let_an_old_start_of_the_owners_in(owner: Client, forger: Client) -> None:
    assert owner.start_leg(1, 90, 45, 120).accepted
    for ahead_ms in (DAY_MS, -DAY_MS, 5000):
        forge(forger, "owner", ahead_ms)
    old = owner.ask(keys.leg_command(2), {**START, "sent_ms": time.monotonic() * 1000 - 3000})
    assert old.reason is Reason.STALE, old


def test_many_invented_names_do_not_let_an_old_start_in(owner: Client, forger: Client) -> None:
    assert owner.start_leg(1, 90, 45, 120).accepted
    sent_ms = time.monotonic() * 1000
    for number in range(SOURCES):
        invented = {**leg_payload("stop"), "source": f"invented {number}", "sent_ms": number}
        assert forger.ask(keys.leg_command(6), invented).accepted
    # A second later than what it says, without waiting for a second.
    old = owner.ask(keys.leg_command(2), {**START, "sent_ms": sent_ms - 1000})
    assert old.reason is Reason.STALE, old
    assert owner.start_leg(2, 90, 45, 120).accepted
    crowded = forge(forger, "newcomer", 0, op="start")
    assert not crowded, "its own delayed commands could not be told from fresh ones"
    assert forge(forger, "newcomer", 0), "a Stop is taken from anybody"
