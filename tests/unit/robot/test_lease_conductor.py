"""Who is driving, from the payload on `hexapod/lease/cmd` to the answer, the frames, the events and the state."""

import asyncio
import json
from typing import Any

import pytest

from schemas import keys
from schemas.button import ButtonAck
from schemas.telemetry import Kind, Reason
from tests.support.robot import LEG_3, START, Robot, started_and_quiet

pytestmark = pytest.mark.virtual_time


async def test_whoever_acquires_it_hears_the_token_and_all_hear_the_name() -> None:
    robot = await started_and_quiet()
    ack = robot.lease("acquire", "anna")
    assert robot.ask(LEG_3, {**START, "lease": ack.lease}).accepted
    assert (ack.accepted, ack.holder, ack.ttl_ms, ack.verified) == (True, "anna", 1000, False)
    assert ack.lease is not None
    (event,) = robot.events(Kind.LEASE_ACQUIRED)
    assert (event.source, event.key, event.detail) == ("anna", keys.LEASE, "anna has acquired the lease")
    await asyncio.sleep(0.1)
    lease = robot.state().lease
    assert (lease.holder, lease.verified, lease.asked_by) == ("anna", False, None)
    assert lease.held_s == pytest.approx(0.1, abs=1e-6)
    assert lease.expires_in_ms == pytest.approx(900, abs=0.001)
    await asyncio.sleep(1)
    assert robot.events()[-1].kind is Kind.LEASE_EXPIRED, "without any other message"


# ---- requests that are none

TOKEN = "0123456789abcdef" * 2
ALIVE = {"do": "alive", "button": TOKEN, "count": 1}
BAD: list[tuple[str, object, Reason, str]] = [
    (keys.LEASE, b"{", Reason.MALFORMED, "the payload is not JSON"),
    (keys.LEASE, [], Reason.INVALID, "the payload: Input should be an object"),
    (keys.LEASE, {"do": "grab"}, Reason.INVALID, "do: Input should be one of 'challenge', 'acquire', 'ask', 'take', "),
    (keys.LEASE, {"do": "acquire", "source": "a", "proof": {}}, Reason.INVALID, "proof.nonce: Field required"),
    (keys.LEASE, {"do": "renew", "lease": TOKEN[:-1]}, Reason.INVALID, "lease: String should have"),
    (keys.LEASE, {"do": "renew", "lease": TOKEN.upper()}, Reason.INVALID, "lease: String should match"),
    (keys.LEASE, {"do": "renew", "lease": TOKEN}, Reason.NOT_HOLDER, "this is not the token"),
    (keys.LEASE, {"do": "renew", "lease": TOKEN, TOKEN: 1}, Reason.INVALID, "(hex digits): Extra"),
    (keys.BUTTON, {"do": "alive", "button": TOKEN}, Reason.INVALID, "count: Field required"),
    (keys.BUTTON, ALIVE, Reason.UNKNOWN_BUTTON, "this button is not registered"),
    (keys.BUTTON, {**ALIVE, "count": 2**53 + 1}, Reason.INVALID, "count: Input should be less than or equal"),
    (keys.BUTTON, {"do": "press"}, Reason.INVALID, "do: Input should be one of 'challenge', 'register', 'alive', 'lea"),
]


@pytest.mark.parametrize(("key", "payload", "reason", "detail"), BAD, ids=lambda value: repr(value)[:60])
async def test_what_is_no_request_is_answered_and_told_and_repeats_nothing(
    key: str, payload: object, reason: Reason, detail: str
) -> None:
    robot, _ = await watched()
    data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    answers: list[bytes] = []
    {keys.LEASE: robot.leases, keys.BUTTON: robot.buttons}[key].read(data, robot.now_ns(), answers.append)()
    ack = json.loads(answers[0])
    assert (ack["accepted"], ack["reason"]) == (False, reason)
    assert ack["detail"].startswith(detail)
    (event,) = robot.events(Kind.COMMAND_REJECTED)
    assert (event.key, event.reason) == (key, reason)
    assert TOKEN.lower() not in (answers[0].decode() + event.model_dump_json()).lower()
    assert robot.state().buttons.alive == 1


# ---- Who watches, from the payload on `hexapod/button/cmd` to the answer, the frames, the events and the state


async def watched(required: int = 1, **buttons: Any) -> tuple[Robot, ButtonAck]:
    """The kitchen is alive."""
    robot = await started_and_quiet(buttons={"required": required, **buttons}, watchdog={"timeout_ms": 10_000})
    ack = robot.button("register", "kitchen")
    assert robot.button("alive", button=ack.button, count=1).accepted
    return robot, ack


@pytest.mark.parametrize(
    ("names", "counts"),
    [((), True), (("kitchen",), True), (("door", "kitchen"), True), (("door",), False), (("button",), False)],
)
async def test_where_names_are_wanted_others_do_not_count(names: tuple[str, ...], counts: bool) -> None:
    """Without certificates nobody has a role, and a person is what stands before the slash."""
    robot = await started_and_quiet(buttons={"required": 1, "names": names})
    ack = robot.button("register", "kitchen/phone")
    alive = robot.button("alive", button=ack.button, count=1)
    assert (alive.accepted, alive.alive, alive.detail is None) == (True, int(counts), counts)
    assert robot.state().buttons.names == ("kitchen/phone",)
    assert robot.ask(LEG_3, START).accepted is counts
    again = robot.button("alive", button=ack.button, count=1)
    assert (again.accepted, again.reason) == (False, Reason.STALE)
    assert robot.button("leave", button=ack.button).accepted
    assert robot.state().buttons.alive == 0


async def test_without_a_ca_a_challenge_has_no_nonce_and_names_are_taken_as_they_are() -> None:
    robot, _ = await watched()
    ack = robot.button("challenge")
    assert (ack.accepted, ack.nonce) == (True, None)
