"""Who is driving, from the payload on `hexapod/lease/cmd` to the answer, the frames, the events and the state."""

import asyncio
import json
from typing import Any

import pytest

from schemas import keys
from schemas.lease import LeaseAck
from schemas.telemetry import Kind, Reason
from tests.support.robot import Robot, leg, started_and_quiet

LEG_3 = keys.leg_command(3)
START, SET, STOP = leg("start", 90, 90, 90), leg("set", 45, 45, 45), leg("stop")
pytestmark = pytest.mark.virtual_time


def with_token(command: dict[str, Any], ack: LeaseAck) -> dict[str, Any]:
    return {**command, "lease": ack.lease}


async def driven_by_anna(**sections: Any) -> tuple[Robot, LeaseAck]:
    robot = await started_and_quiet(**sections)
    ack = robot.lease("acquire", "anna")
    assert robot.ask(LEG_3, with_token(START, ack)).accepted
    return robot, ack


async def test_whoever_acquires_it_hears_the_token_and_all_hear_the_name() -> None:
    robot, ack = await driven_by_anna()
    assert (ack.accepted, ack.holder, ack.ttl_ms, ack.verified) == (True, "anna", 1000, False)
    assert ack.lease is not None
    (event,) = robot.events(Kind.LEASE_ACQUIRED)
    assert (event.source, event.key, event.detail) == ("anna", keys.LEASE, "anna has acquired the lease")
    await asyncio.sleep(0.1)
    lease = robot.conductor.reports.state().lease
    assert (lease.holder, lease.verified, lease.asked_by) == ("anna", False, None)
    assert lease.held_s == pytest.approx(0.1, abs=1e-6)
    assert lease.expires_in_ms == pytest.approx(900, abs=0.001)
    await asyncio.sleep(1)
    assert robot.events()[-1].kind is Kind.LEASE_EXPIRED, "without any other message"


# ---- requests that are none

TOKEN = "0123456789abcdef" * 2
BAD: list[tuple[bytes, Reason, str]] = [
    (b"", Reason.MALFORMED, "the payload is not JSON"),
    (b"{", Reason.MALFORMED, "the payload is not JSON"),
    (b"[]", Reason.INVALID, "do must be"),
    (b'{"do": "grab"}', Reason.INVALID, "do must be"),
    (b'{"do": 1}', Reason.INVALID, "do must be"),
    (b'{"source": "anna"}', Reason.INVALID, "do must be"),
    (b'{"do": "acquire"}', Reason.INVALID, "source is missing"),
    (b'{"do": "acquire", "source": ""}', Reason.INVALID, "source is missing, or not"),
    (b'{"do": "acquire", "source": "' + b"x" * 65 + b'"}', Reason.INVALID, "source is missing, or not"),
    (b'{"do": "acquire", "source": "anna", "proof": {}}', Reason.INVALID, "proof.nonce is missing"),
    (b'{"do": "renew"}', Reason.INVALID, "lease is missing"),
    (json.dumps({"do": "renew", "lease": TOKEN[:-1]}).encode(), Reason.INVALID, "lease is missing, or not"),
    (json.dumps({"do": "renew", "lease": TOKEN + "0"}).encode(), Reason.INVALID, "lease is missing, or not"),
    (json.dumps({"do": "renew", "lease": TOKEN.upper()}).encode(), Reason.INVALID, "lease is missing, or not"),
    (json.dumps({"do": "renew", "lease": TOKEN}).encode(), Reason.NOT_HOLDER, "this is not the token"),
    (json.dumps({"do": "release", "lease": TOKEN, "to": 7}).encode(), Reason.INVALID, "to is missing, or not"),
    (
        json.dumps({"do": "renew", "lease": TOKEN, TOKEN: 1}).encode(),
        Reason.INVALID,
        "the payload has a field that is not known",
    ),
    (json.dumps({"do": TOKEN}).encode(), Reason.INVALID, "do must be"),
    (json.dumps({"do": "acquire", "source": {"a": TOKEN}}).encode(), Reason.INVALID, "source is missing, or not"),
]


@pytest.mark.parametrize(("payload", "reason", "detail"), BAD, ids=lambda value: repr(value)[:60])
async def test_what_is_no_request_is_answered_and_told_and_repeats_nothing(
    payload: bytes, reason: Reason, detail: str
) -> None:
    robot = await started_and_quiet()
    answers: list[bytes] = []
    robot.leases.read(payload, robot.now_ns(), answers.append)()
    ack = LeaseAck.model_validate_json(answers[0])
    assert (ack.accepted, ack.reason) == (False, reason)
    assert ack.detail is not None
    assert ack.detail.startswith(detail)
    (event,) = robot.events(Kind.COMMAND_REJECTED)
    assert (event.key, event.reason) == (keys.LEASE, reason)
    assert TOKEN.lower() not in (answers[0].decode() + event.model_dump_json()).lower()


async def test_after_the_end_nobody_is_answered() -> None:
    robot = await started_and_quiet()
    robot.conductor.close()
    answers: list[bytes] = []
    robot.leases.read(b'{"do": "acquire", "source": "anna"}', 0, answers.append)()
    robot.buttons.read(b'{"do": "register", "source": "kitchen"}', 0, answers.append)()
    assert answers == []


async def test_no_report_has_the_token() -> None:
    robot, anna = await driven_by_anna(telemetry={"frames": True})
    robot.lease("ask", "bert")
    robot.ask(LEG_3, {"servos": 1, "lease": anna.lease})
    robot.ask(LEG_3, {"servos": anna.lease})
    robot.ask(LEG_3, [with_token(SET, anna)])
    robot.ask(LEG_3, {str(anna.lease): 1})
    robot.lease("take", "bert")
    robot.ask(LEG_3, with_token(SET, anna))
    state = robot.conductor.reports.state()
    out = "".join(report.model_dump_json() for report in (*(each for _, each in robot.reports), state))
    assert anna.lease is not None
    assert anna.lease not in out
    assert "anna" in out
