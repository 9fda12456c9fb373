"""Whether a sender is still there, which of several is followed, and what an error in one message ends."""

import logging

import pytest

from gateway.people.ros2.received import SILENT_S, Rivals, presence, read_each

A, B, C = b"a", b"b", b"c"


@pytest.mark.parametrize(
    ("sender", "before", "now", "there"),
    [
        (A, {A, B}, {A}, True),
        (A, {A, B}, {B}, False),
        (C, {A, B}, {A, B}, True),
        (C, {A, B}, {B}, False),
        (C, set(), {A}, False),
        (b"", {A}, {A, B}, True),
        (b"", {A}, {B}, False),
    ],
)
def test_a_sender_that_is_not_seen_is_there_while_all_others_are(
    sender: bytes, before: set[bytes], now: set[bytes], there: bool
) -> None:
    present = set(before)
    is_there = presence(sender, lambda: present)
    present.clear()
    present.update(now)
    assert is_there() is there


def test_an_error_in_one_message_does_not_end_the_topic(caplog: pytest.LogCaptureFixture) -> None:
    taken: list[int] = []

    def take(number: int) -> None:
        taken.append(10 // number)

    with caplog.at_level(logging.ERROR):
        read_each([5, 0, 2], take)
    assert taken == [2, 5]
    assert "a message could not be handled" in caplog.text


def test_the_first_is_followed_until_it_is_silent() -> None:
    rivals = Rivals()
    assert rivals.may_send(B, 0.0), "nobody has sent"
    rivals.sent(A, 10.0)
    assert rivals.may_send(A, 10.1)
    assert not rivals.may_send(B, 10.1)
    rivals.sent(A, 10.2)
    assert not rivals.may_send(B, 10.2 + SILENT_S)
    assert rivals.may_send(B, 10.3 + SILENT_S)
    rivals.sent(B, 10.3 + SILENT_S)
    assert not rivals.may_send(A, 10.4 + SILENT_S), "and now the other"


def test_a_graph_that_reports_no_senders_has_one() -> None:
    rivals = Rivals()
    rivals.sent(b"", 10.0)
    assert rivals.may_send(b"", 10.0)
