"""What was sent before an emergency stop does not undo it, and what waited too long on its way moves nothing."""

import json
import signal
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from gateway.client import Client
from gateway.people.client.payloads import leg_payload
from schemas import keys
from schemas.event import Event
from schemas.words import Kind, Mode, Reason
from tests.support.cut_link import CutLink
from tests.support.fixtures import client_fixture, gateway_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import Heard, events, servos_on

START = leg_payload("start", (90, 45, 120))
MAX_AGE_MS = 1500
"""A busy machine delays a command by less."""
HELD_S = 1.8
FROZEN_S = 3.0

gateway = gateway_fixture({"limits": {"max_age_ms": MAX_AGE_MS}, "watchdog": {"timeout_ms": 10_000}}, scope="function")
bystander = client_fixture("bystander")


@pytest.fixture
def heard(bystander: Client) -> Heard[Event]:
    return events(bystander)


@pytest.fixture
def link(gateway: Gateway) -> Iterator[CutLink]:
    with CutLink(gateway.endpoint) as made:
        yield made


@pytest.fixture
def laptop(link: CutLink, bystander: Client) -> Iterator[Client]:
    """Yield a laptop behind a link that can be cut; the gateway knows it."""
    with Client(link.endpoint, source="laptop", timeout_s=5) as client:
        assert client.start_leg(1, 90, 45, 120).accepted
        assert bystander.stop().accepted
        yield client


def pass_time(seconds: float) -> None:
    """Wait in real time: time itself is under attack here."""
    threading.Event().wait(seconds)


def put(client: Client, key: str, payload: dict[str, Any]) -> None:
    """Put as any program does: without `source` and `sent_ms`."""
    client.session.put(
        key, json.dumps(payload), encoding="application/json", congestion_control=zenoh.CongestionControl.BLOCK
    )


def rejected(heard: Heard[Event], key: str, count: int = 1) -> Event:
    return heard.wait(lambda event: event.kind is Kind.COMMAND_REJECTED and event.key == key, count=count)


def test_a_reset_from_behind_a_cut_link_leaves_no_emergency_stop(
    gateway: Gateway, link: CutLink, laptop: Client, bystander: Client, heard: Heard[Event]
) -> None:
    del gateway
    for attempt in (1, 2):
        first = bystander.estop().estop
        link.cut()
        for payload in ({}, {"estop": first}):
            put(laptop, keys.RESET, payload)
        laptop.publish(keys.RESET, {"estop": first})
        laptop.publish(keys.leg_command(1), START)
        pass_time(0.3)
        second = bystander.estop().estop
        assert (first, second) == (2 * attempt - 1, 2 * attempt)
        link.fix()
        rejected(heard, keys.RESET, count=3 * attempt)
        rejected(heard, keys.leg_command(1), count=attempt)
        state = bystander.state()
        assert (state.mode, state.estop) == (Mode.ESTOPPED, second)
        assert not servos_on(state)
        assert laptop.reset(first, check=False).detail == (
            f"a newer emergency stop was requested: estop is {first}, and the latest is {second}"
        )
        assert laptop.reset().accepted, "it looks up the latest"


def test_a_gateway_that_was_frozen_executes_nothing_that_waited_in_it(
    gateway: Gateway, laptop: Client, bystander: Client, heard: Heard[Event]
) -> None:
    assert laptop.start_leg(1, 90, 45, 120).accepted
    gateway.child.send_signal(signal.SIGSTOP)
    laptop.publish(keys.leg_command(2), START)  # its clock is known, and says that this is old
    put(laptop, keys.leg_command(3), START)  # of this nothing is known
    put(bystander, keys.leg_command(4), START)
    pass_time(FROZEN_S)
    gateway.child.send_signal(signal.SIGCONT)
    for leg in (2, 3, 4):
        assert rejected(heard, keys.leg_command(leg)).reason is Reason.STALE
    assert servos_on(bystander.state()) <= {11, 12, 13}
    assert laptop.start_leg(2, 90, 45, 120).accepted, "its clock says that this one is fresh"
    assert bystander.stop().accepted
    assert bystander.estop().stop_frames == 6
    pass_time(HELD_S)
    assert bystander.reset().accepted
    put(bystander, keys.leg_command(4), START)
    assert bystander.set_leg(4, 90, 45, 120).accepted, "after a while it is as before"
    assert bystander.stop().accepted
