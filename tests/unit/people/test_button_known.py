"""A button's check-ins, in virtual time: when the next is due, and whether the gateway counts it."""

from gateway.people.tools.button.known import AGAIN_S, SHARE, Known

TIMEOUT_S = 2.0


def test_a_check_in_counts_from_when_it_was_sent() -> None:
    known = Known(5.0)
    assert known.counts(5.0 + TIMEOUT_S - 0.001, TIMEOUT_S)
    assert not known.counts(5.0 + TIMEOUT_S, TIMEOUT_S)
    known.accepted((2, 1), 6.0)
    assert (known.count, known.silence_s(6.5)) == ((2, 1), 0.5)
    assert not known.counts(6.0 + TIMEOUT_S, TIMEOUT_S)


def test_it_is_not_counted_after_one_that_was_not_accepted_or_where_it_is_over() -> None:
    known = Known(0.0)
    known.trouble = "no gateway answered"
    assert not known.counts(0.0, TIMEOUT_S)
    known.accepted((1, 1), 0.1)
    assert known.counts(0.1, TIMEOUT_S)
    known.refused = "another has the name"
    assert not known.counts(0.1, TIMEOUT_S)


def test_three_may_be_lost_and_one_without_an_answer_is_followed_soon() -> None:
    known = Known(0.0)
    assert known.next_s(1.0, TIMEOUT_S) == 1.0 + TIMEOUT_S / SHARE
    known.trouble = "no gateway answered"
    assert known.next_s(1.0, TIMEOUT_S) == 1.0 + AGAIN_S


def test_the_name_is_anothers_where_the_gateway_is_older_than_the_registration() -> None:
    known = Known(100.0)
    assert known.is_taken(uptime_s=10.001, now_s=110.0)
    assert not known.is_taken(uptime_s=10.0, now_s=110.0), "it was started since, and knows nobody"
    known.registered(109.0)
    assert known.is_taken(uptime_s=10.0, now_s=110.0)
