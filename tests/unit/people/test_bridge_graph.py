"""Which graph the bridge is in, and whether a sender is still there."""

import logging
from importlib.machinery import ModuleSpec

import pytest

from gateway.people.bridge import command
from gateway.people.bridge.command import Via
from gateway.people.bridge.graph import presence, read_each


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize(
    ("rmw", "usual"), [(None, False), ("", False), ("rmw_zenoh_cpp", False), ("rmw_fastrtps_cpp", True)]
)
def test_by_rclpy_where_another_rmw_is_set_and_rclpy_is_there(
    rmw: str | None, usual: bool, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RMW_IMPLEMENTATION", raising=False)
    if rmw is not None:
        monkeypatch.setenv("RMW_IMPLEMENTATION", rmw)
    monkeypatch.setattr(command, "find_spec", lambda name: ModuleSpec(name, None) if there else None)
    assert Via.usual() is (Via.RCLPY if usual and there else Via.ZENOH)


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
