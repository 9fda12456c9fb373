"""A button's check-ins, in virtual time: when the next is due, and whether the gateway counts it."""

import pytest

from gateway.people.tools.button.known import CHECK_IN_AGAIN_S, DENIED_S, LATE_SHARE, SHARE, Known, is_taken

TIMEOUT_S = 2.0


def test_a_check_in_counts_from_when_it_was_sent() -> None:
    known = Known(5.0)
    assert known.counts(5.0 + TIMEOUT_S - 0.001, TIMEOUT_S)
    assert not known.counts(5.0 + TIMEOUT_S, TIMEOUT_S)
    known.accepted((2, 1), "one is late", 6.0, 6.1)
    assert (known.count, known.detail, known.silence_s(6.5)) == ((2, 1), "one is late", 0.5)
    assert not known.counts(6.0 + TIMEOUT_S, TIMEOUT_S)


def test_before_the_first_answer_nobody_is_alive_and_nothing_is_late() -> None:
    known = Known(0.0)
    assert (known.count, known.detail, known.late_s(0.0)) == ((0, 0), "", None)


def test_it_is_not_counted_after_one_that_was_not_accepted_or_where_it_is_over() -> None:
    known = Known(0.0)
    known.failed("no gateway answered", denied=False)
    assert not known.counts(0.0, TIMEOUT_S)
    known.accepted((1, 1), "", 0.1, 0.2)
    assert known.counts(0.1, TIMEOUT_S)
    known.refused = "another has the name"
    assert not known.counts(0.1, TIMEOUT_S)


def test_three_may_be_lost_one_without_an_answer_is_followed_soon_and_one_that_is_denied_later() -> None:
    known = Known(0.0)
    assert known.next_s(1.0, TIMEOUT_S) == 1.0 + TIMEOUT_S / SHARE
    known.failed("no gateway answered", denied=False)
    assert known.next_s(1.0, TIMEOUT_S) == 1.0 + CHECK_IN_AGAIN_S
    known.failed("button_denied", denied=True)
    assert known.next_s(1.0, TIMEOUT_S) == 1.0 + DENIED_S
    known.registered()
    assert known.next_s(1.0, TIMEOUT_S) == 1.0 + TIMEOUT_S / SHARE
    known.failed("no gateway answered", denied=False)
    known.accepted((1, 1), "", 2.0, 2.1)
    assert known.next_s(2.0, TIMEOUT_S) == 2.0 + TIMEOUT_S / SHARE


def test_an_answer_that_takes_a_quarter_of_what_it_counts_comes_late() -> None:
    known = Known(0.0)
    assert known.late_s(TIMEOUT_S) is None
    known.accepted((1, 1), "", 1.0, 1.0 + LATE_SHARE * TIMEOUT_S)
    assert known.late_s(TIMEOUT_S) is None
    known.accepted((1, 1), "", 1.0, 1.001 + LATE_SHARE * TIMEOUT_S)
    assert known.late_s(TIMEOUT_S) == pytest.approx(0.001 + LATE_SHARE * TIMEOUT_S)


def test_the_name_is_anothers_where_the_gateway_is_older_than_the_registration() -> None:
    assert is_taken(uptime_s=10.001, registered_s=100.0, now_s=110.0)
    assert not is_taken(uptime_s=10.0, registered_s=100.0, now_s=110.0), "it was started since, and knows nobody"
