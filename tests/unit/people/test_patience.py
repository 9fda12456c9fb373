"""How long a question waits, when it is sent again or by another way, and which answer counts: in virtual time."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.people.client.patience import ATTEMPT_S, OTHER_WAY_S, RESEND_S, Patience, Query, QuestionStep

END_S = 10.0


def asked(*, again: bool = True, other_ways: bool = False) -> tuple[Patience[str], Query[str]]:
    """A question that was sent at 0 s."""
    patience: Patience[str] = Patience(0.0, END_S, again=again, other_ways=other_ways)
    return patience, patience.sent(0.0)


def test_the_dialled_programs_answer_counts_at_once() -> None:
    patience, query = asked()
    assert patience.step(0.001) is QuestionStep.WAIT
    patience.replied(query, "own", own=True)
    patience.replied(query, "later", own=True)
    assert (patience.step(0.002), patience.answer) == (QuestionStep.OVER, "own")


def test_anothers_answer_is_better_than_none_in_the_end() -> None:
    patience, query = asked()
    assert patience.step(ATTEMPT_S) is QuestionStep.AGAIN
    patience.replied(query, "foreign", own=False)
    assert patience.step(END_S) is QuestionStep.OVER
    assert patience.answer == "foreign"


def test_a_stop_without_an_answer_is_sent_again_each_second_until_its_end() -> None:
    patience, _ = asked()
    assert patience.next_s == ATTEMPT_S
    assert patience.step(ATTEMPT_S - 0.001) is QuestionStep.WAIT
    for number in range(1, 10):
        assert patience.step(number * ATTEMPT_S) is QuestionStep.AGAIN
        patience.sent(number * ATTEMPT_S)
        assert patience.step(number * ATTEMPT_S) is QuestionStep.WAIT
        assert patience.next_s == (number + 1) * ATTEMPT_S
    assert (patience.step(END_S), patience.answer) == (QuestionStep.OVER, None)


def test_while_another_query_is_under_way_a_lost_link_changes_nothing() -> None:
    patience, first = asked()
    patience.sent(0.1)
    patience.ended(first, 0.2)
    assert (patience.step(0.9), patience.next_s) == (QuestionStep.WAIT, ATTEMPT_S)


def test_what_is_no_stop_is_sent_once_and_ends_where_everybody_has_declined() -> None:
    patience, query = asked(again=False)
    assert patience.next_s == END_S
    assert patience.step(END_S - 0.001) is QuestionStep.WAIT
    patience.ended(query, 1.0)
    assert (patience.step(1.0), patience.answer) == (QuestionStep.OVER, None)
    assert asked(again=False)[0].step(END_S) is QuestionStep.OVER


def test_another_way_is_searched_for_once_and_at_once_where_the_link_is_lost() -> None:
    patience, _ = asked(other_ways=True)
    assert (patience.step(OTHER_WAY_S - 0.001), patience.next_s) == (QuestionStep.WAIT, OTHER_WAY_S)
    assert patience.step(OTHER_WAY_S) is QuestionStep.OTHER_WAY
    assert (patience.step(OTHER_WAY_S), patience.next_s) == (QuestionStep.WAIT, ATTEMPT_S)
    lost, query = asked(other_ways=True)
    lost.ended(query, 0.01)
    assert lost.step(0.01) is QuestionStep.OTHER_WAY
    assert lost.step(0.01) is QuestionStep.WAIT


@given(st.lists(st.tuples(st.sampled_from(["own", "foreign", "ends", "wait"]), st.floats(0, 0.4)), max_size=30))
def test_in_any_order_a_stop_is_sent_again_within_a_second_until_an_answer_counts(
    happens: list[tuple[str, float]],
) -> None:
    patience, query = asked()
    under_way, sent_s, now_s, own = [query], 0.0, 0.0, False
    for what, by_s in happens:
        now_s += by_s
        if what == "ends" and under_way:
            patience.ended(under_way.pop(0), now_s)
        elif what in ("own", "foreign") and under_way:
            patience.replied(under_way[0], what, own=what == "own")
            own = own or what == "own"
        step = patience.step(now_s)
        assert (step is QuestionStep.OVER) == (patience.answer is not None or now_s >= END_S)
        assert not own or patience.answer is not None
        if step is QuestionStep.AGAIN:
            under_way.append(patience.sent(now_s))
            sent_s = now_s
        elif step is QuestionStep.WAIT:
            assert now_s < patience.next_s <= sent_s + (ATTEMPT_S if under_way else RESEND_S)
        else:
            return
