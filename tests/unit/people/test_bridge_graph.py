"""Whether a sender is still there, and what an error in one message ends."""

import logging

import pytest

from gateway.people.bridge.graph import presence, read_each

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
