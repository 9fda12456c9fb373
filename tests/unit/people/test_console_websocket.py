"""What one page may send, and when a page of which nothing comes is given up, in virtual time."""

import doctest

from hypothesis import given
from hypothesis import strategies as st

from gateway.people.console import websocket
from gateway.people.console.websocket import PING_S, Allowance, Quiet

A_SECOND = 10.0
AT_ONCE = 5.0


def looks(quiet: Quiet, end_s: float) -> tuple[list[float], float | None]:
    """As the WebSocket does until `end_s`: when the page was asked, and when it was given up."""
    asked_s: list[float] = []
    for _ in range(10):
        if (now_s := quiet.due_s) > end_s:
            break
        if quiet.is_gone(now_s):
            return asked_s, now_s
        if quiet.must_ask(now_s):
            asked_s.append(now_s)
    return asked_s, None


def test_a_page_of_which_nothing_comes_is_asked_after_twenty_seconds_and_gone_after_forty() -> None:
    assert looks(Quiet(0.0), 100.0) == ([20.0], 40.0)
    assert PING_S == 20


def test_a_page_that_answers_is_there() -> None:
    quiet = Quiet(0.0)
    for answered_s in (20.5, 41.0, 80.9):  # the last one just in time
        assert looks(quiet, answered_s)[1] is None
        quiet.received(answered_s)
    assert looks(quiet, 200.0) == ([100.9], 120.9)


def test_a_page_that_talks_is_not_asked() -> None:
    quiet = Quiet(0.0)
    for second in range(1, 100):
        quiet.received(float(second))
        assert looks(quiet, second + 1.0) == ([], None)


def test_so_many_at_once_and_then_so_many_a_second() -> None:
    allowance = Allowance(A_SECOND, AT_ONCE, now_s=0.0)
    assert [allowance.take(0.0) for _ in range(6)] == [True] * 5 + [False]
    assert allowance.wait_s(0.0) == 2 / A_SECOND, "what was too much has to be made up"
    assert allowance.wait_s(0.2) == 0
    assert [allowance.take(0.2), allowance.take(0.2)] == [True, False]


def test_a_long_pause_allows_no_more_than_at_once() -> None:
    allowance = Allowance(A_SECOND, AT_ONCE, now_s=0.0)
    assert not allowance.take(3600.0, AT_ONCE + 1)


@given(st.lists(st.tuples(st.floats(0, 3), st.integers(1, 4)), min_size=1, max_size=30))
def test_no_stretch_of_time_holds_more_than_its_rate_and_what_is_allowed_at_once(
    taken: list[tuple[float, int]],
) -> None:
    allowance = Allowance(A_SECOND, AT_ONCE, now_s=0.0)
    now_s, count = 0.0, 0
    for pause_s, wanted in taken:
        now_s += pause_s
        if not allowance.take(now_s, wanted):
            return
        count += wanted
        assert count <= now_s * A_SECOND + AT_ONCE + 1e-6


def test_the_examples_are_right() -> None:
    assert doctest.testmod(websocket) == (0, 3)
