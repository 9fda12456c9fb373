"""Who drives: each rule of the lease, judged by the oracle as well; and from a payload to the answer and the state."""

import asyncio
import json
from typing import Any, Final

import pytest

from gateway.robot.core.events import RequestAnswer
from gateway.robot.core.lease import MOST_ASKERS
from schemas import keys
from schemas.button import ButtonAck
from schemas.words import Kind, Reason
from tests.support.robot import LEG_3, START, Robot, started_and_quiet
from tests.support.scenes import Scenes, play, scene_test

pytestmark = pytest.mark.virtual_time


BERT: Final = "bert"
HELD: Final = """
    0 lease acquire anna (fresh anna) → announce lease_acquired; granted
    1 leg 1 start 90 (lease anna) → command 1 start 90; completed 1
"""
"""Anna holds the lease since 0 ms, and leg 1 runs."""
SLOW: Final = "rules timeout_ms=10000, rest_ns=10_000_000_000" + HELD
"""With a watchdog that does not stop the leg before."""


@pytest.mark.parametrize("other", ["", " (lease bert)", " (lease annA)"])
def test_only_its_holder_moves_and_resets_and_everybody_stops(other: str) -> None:
    play(f"""{HELD}
        30 leg 1 set 45{other} → rejected 2 not_holder
        30 leg 2 start 90{other} → rejected 3 not_holder
        31 servo 11 stop{other} → command 11 stop; completed 4
        32 leg 1 stop | set 1 | set 1{other} → command 11 stop; rejected 5 not_holder stopped
        33 estop → estop 1-6 stop; announce estop_engaged
        34 reset{other} → rejected 6 not_holder
        35 reset (lease anna) → announce estop_reset; completed 7
        36 calibrate 32 trim 1{other} → rejected 8 not_holder""")


def test_a_takeover_stops_all_six_legs_first() -> None:
    robot = play(f"""{HELD}
        2 leg 1 set 45 (lease anna)
        3 lease take bert (fresh bert)
            → command 1-6 stop; rejected 2 not_holder; announce lease_taken; granted
        announces bert has taken the lease from anna; all six legs are stopped
        source bert""")
    assert robot.only(RequestAnswer).token == BERT
    robot.play("""
        30 leg 1 start 90 (lease anna) → rejected 3 not_holder
        31 leg 1 set 45 (lease bert) → rejected 4 servo_stopped
        32 leg 1 start 90 (lease bert) → command 1 start 90; completed 5
        60 leg 1 stop (lease anna) → command 1 stop; completed 6""")


@pytest.mark.parametrize(
    "kept", ["lease renew (token anna)", "reset (lease anna)", "leg 1 set 45 (lease anna)", "leg 1 stop (lease anna)"]
)
def test_whatever_of_its_holder_is_accepted_keeps_it(kept: str) -> None:
    play(f"""{SLOW}
        900 {kept}
        1001 time → nothing
        due 1900
        1900 time → announce lease_expired""")


def test_few_askers_are_remembered_the_latest() -> None:
    asked = "\n".join(f"2 lease ask person {number}" for number in range(MOST_ASKERS + 1))
    play(f"""{HELD}{asked}
        3 lease release to person 0 (token anna) → lease_denied
        3 lease release to person 1 (token anna) → announce lease_released; granted""")


def test_no_repr_shows_a_token() -> None:
    anna, bert = "a" * 32, "b" * 32
    robot = Scenes()
    seen = [*map(repr, robot.do(0, f"lease acquire anna (fresh {anna})")), repr(robot.effects)]
    for words in (f"renew (token {anna})", f"take bert (fresh {bert})"):
        robot.do(2, f"lease {words}")
        seen += [repr(robot.effects), repr(robot.only(RequestAnswer)), repr(robot.supervisor.lease)]
    assert not [each for each in seen if anna in each or bert in each]


SCENES: Final = {
    # It may be that of somebody whose lease was taken, and has been released since.
    "a token is rejected while it is free and stops are not": """
        1 leg 1 start 90 (lease anna) → rejected 1 not_holder
        2 leg 1 stop (lease anna) → command 1 stop; completed 2
        3 estop
        4 reset (lease anna) → rejected 3 not_holder
        5 lease ask bert → no_lease""",
    "where it is required nothing moves without it": """
        rules lease_required=True
        1 leg 1 start 90 → rejected 1 no_lease
        2 leg 1 stop → command 1 stop; completed 2
        3 estop
        4 reset → announce estop_reset; completed 3  # a reset moves nothing
        5 lease acquire anna (fresh anna)
        6 leg 1 start 90 (lease anna) → command 1 start 90; completed 4
        7 lease release (token anna)
        announces anna has released the lease
        30 leg 1 set 45 → rejected 5 no_lease""",
    "what others had waiting is dropped for a new holder": """
        1 leg 3 start 90
        2 leg 3 set 95 → nothing  # it waits for its rate slot
        3 lease acquire anna (fresh anna) → rejected 2 not_holder; …""",
    "a command that comes after its ttl does not save it": f"""{SLOW}
        1001 leg 1 set 45 (lease anna) → announce lease_expired; rejected 2 not_holder
        1002 lease release (token anna) → not_holder""",
}
test_a_scene = scene_test(SCENES)


ANNA_HOLDS_IT: Final = {
    "a rejection names the holder": """
        30 leg 1 set 45 → rejected 2 not_holder
        says anna holds the lease
        30 leg 1 set 45 (lease bert) → rejected 3 not_holder
        says the command's own lease has ended, and anna holds the lease""",
    "silence loses it in its ttl and the legs are the watchdogs affair": """
        251 time → watchdog 1 stop; announce watchdog_expired
        due 1001
        1000.999 time → nothing
        1001 time → announce lease_expired
        announces anna was silent for 1000 ms and has lost the lease
        source anna
        asked nobody
        1002 leg 1 start 90 (lease anna) → rejected 2 not_holder
        1003 lease renew (token anna) → not_holder
        1004 lease acquire bert (fresh bert) → announce lease_acquired; granted""",
    "a client that asks is announced, and changes nothing": """
        2 lease ask bert → announce lease_asked; granted
        announces bert asks anna for the lease
        source bert
        asked bert
        3 lease ask carl
        asked carl
        4 lease ask bert
        asked bert
        30 leg 1 set 45 (lease anna) → command 1 set 45; completed 2
        251 lease renew (token anna)
        1400 time → …; announce lease_expired; …
        asked nobody""",
    "a handover goes to one who has asked and the legs go on": """
        2 lease release to bert (token anna) → lease_denied  # he has not asked
        3 lease ask bert
        4 lease release to nobody (token anna) → lease_denied
        30 leg 1 set 45 (lease anna) → command 1 set 45; completed 2  # it is still hers
        31 lease release to bert (token anna) → announce lease_released; granted
        holder bert
        60 leg 1 set 45 (lease anna) → rejected 3 not_holder
        60 leg 1 set 45 (lease bert) → rejected 4 not_holder
        60 leg 1 set 45 → rejected 5 not_holder
        61 lease acquire carl (fresh carl) → lease_held
        answers the lease is handed over to bert
        61 lease ask carl → lease_held
        62 lease acquire bert (fresh bert) → announce lease_acquired; granted
        63 leg 1 set 45 (lease bert) → command 1 set 45; completed 6""",
    "the end of the service ends it": """
        2 end
        holder nobody
        due never
        3 lease take bert (fresh bert) → stopping""",
}
test_a_scene_in_which_anna_holds_it = scene_test(ANNA_HOLDS_IT, HELD)


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
    """Return a robot whose kitchen button is alive."""
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
