"""When a lease is renewed and when it counts as lost, in virtual time: no thread, no gateway."""

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.people.client.renewal import RENEWALS, TRY_AGAIN_S, Holds, Renewal, Waiting
from schemas.lease import LeaseAck
from schemas.telemetry import Reason

TTL_MS = 900.0
TTL_S = TTL_MS / 1000
BEGUN_S = 100.0
DONE = LeaseAck(accepted=True)
TAKEN = LeaseAck(accepted=False, reason=Reason.NOT_HOLDER, detail="bert drives", holder="bert")
FREE = LeaseAck(accepted=False, reason=Reason.NO_LEASE, detail="nobody drives")


def granted(ttl_ms: float = TTL_MS) -> Renewal:
    renewal = Renewal()
    renewal.granted(ttl_ms, BEGUN_S)
    return renewal


def renew(renewal: Renewal, answers: Iterable[LeaseAck | None]) -> list[float]:
    """As the thread does, with these answers (None: silence); when each renewal left, since the lease began."""
    left_s = []
    now_s = BEGUN_S
    for answer in answers:
        if renewal.holds is not Holds.YES:
            break
        now_s = max(now_s, renewal.due_s)
        left_s.append(now_s - BEGUN_S)
        renewal.asked(now_s)
        if answer is None:
            now_s += renewal.answer_s
            renewal.unanswered(now_s)
        else:
            renewal.answered(answer, now_s)
    return left_s


def test_a_gateway_that_is_silent_for_as_long_as_it_lives_has_lost_it() -> None:
    renewal = granted()
    left_s = renew(renewal, [None] * 10)
    assert len([each for each in left_s if each <= TTL_S + 1e-6]) == RENEWALS
    assert renewal.lost is not None
    assert (renewal.holds, renewal.lost.reason, renewal.lost.holder) == (Holds.LOST, Reason.NO_LEASE, None)
    assert "has not answered for 900 ms" in str(renewal.lost)
    assert not renewal.elsewhere, "the legs may still be ours, and are stopped at a stream's end"


@pytest.mark.parametrize(("answer", "holder", "elsewhere"), [(TAKEN, "bert", True), (FREE, None, False)])
def test_what_the_gateway_rejects_is_lost_at_once(answer: LeaseAck, holder: str | None, elsewhere: bool) -> None:
    renewal = granted()
    assert len(renew(renewal, [DONE, answer, DONE])) == 2
    assert renewal.lost is not None
    assert (renewal.lost.holder, renewal.lost.reason, renewal.elsewhere) == (holder, answer.reason, elsewhere)
    assert f"{holder or 'nobody'} holds it now" in str(renewal.lost)


STEPS = st.sampled_from(["confirmed", "taken", "silent", "gives", "keeps", "handed over", "released"])


@given(st.lists(st.tuples(STEPS, st.floats(0, 2 * TTL_S)), max_size=20))
def test_it_ends_once_whatever_crosses(steps: list[tuple[str, float]]) -> None:
    """A renewal that is rejected while it is given away is no loss, and what has ended stays as it ended."""
    renewal, now_s, confirmed_s, ended = granted(), BEGUN_S, BEGUN_S, Holds.YES
    for step, passed_s in steps:
        now_s += passed_s
        match step:
            case "confirmed":
                renewal.answered(DONE, now_s)
                confirmed_s = now_s
            case "taken":
                renewal.answered(TAKEN, now_s)
            case "silent":
                renewal.unanswered(now_s)
            case "gives" | "keeps":
                renewal.gives = step == "gives"
            case _:
                renewal.end(Holds.HANDED_OVER if step == "handed over" else Holds.RELEASED)
        if ended is Holds.YES:
            lost = step == "taken" or (step == "silent" and now_s - confirmed_s > TTL_S)
            if lost and not renewal.gives:
                ended = Holds.LOST
            elif step in ("handed over", "released"):
                ended = Holds.HANDED_OVER if step == "handed over" else Holds.RELEASED
        assert renewal.holds is ended
        assert (renewal.lost is not None) is (ended is Holds.LOST)


def test_it_is_tried_again_three_times_a_second_and_no_longer_than_it_may_wait() -> None:
    waiting = Waiting(BEGUN_S + 1)
    now_s, tries = BEGUN_S, 0
    while tries < 100 and (pause_s := waiting.pause_s(now_s)) > 0:
        assert pause_s <= TRY_AGAIN_S
        now_s, tries = now_s + pause_s, tries + 1
    assert now_s == pytest.approx(BEGUN_S + 1)
    assert tries == 4
    assert waiting.pause_s(now_s + 60) == 0
