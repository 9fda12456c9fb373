"""When a page of which nothing comes is asked, and when it is given up, in virtual time."""

import doctest

from gateway.people.console.server import websocket
from gateway.people.console.server.websocket import PING_S, Quiet


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


def test_the_examples_are_right() -> None:
    assert doctest.testmod(websocket) == (0, 3)
