"""Held keys of a terminal that never says that one is released: how long each counts."""

import pytest

from gateway.people.commands.walk.screen import REPEATED_S, SPEEDS, Keypad
from gateway.people.walking import STILL


@pytest.mark.parametrize(("pause_s", "every_s"), [(0.25, 0.03), (0.5, 0.033), (0.66, 0.04), (0.5, 0.09)])
def test_a_held_key_has_no_gap_and_ends_soon_after_its_release(pause_s: float, every_s: float) -> None:
    """X11's, GNOME's and Windows' repetitions."""
    pad = Keypad()
    pad.press("up", 0.0)
    now_s = 0.0
    while now_s < 3.0:
        assert pad.velocity(now_s).forward_m_s > 0
        if now_s >= pause_s:
            pad.press("up", now_s)
            last_s = now_s
            now_s += every_s
        else:
            now_s = min(pause_s, now_s + 0.02)
    assert pad.velocity(last_s + REPEATED_S - 0.01) != STILL
    assert pad.velocity(last_s + REPEATED_S) == STILL


def test_another_key_ends_it_and_the_newest_counts() -> None:
    pad = Keypad()
    pad.press("w", 0.0)
    pad.press("left", 0.1)
    assert pad.velocity(0.1).turn_rad_s > 0
    assert pad.velocity(0.1).forward_m_s == 0
    assert not pad.press("t", 0.2)
    assert pad.velocity(0.2) == STILL


def test_the_speed_has_ends() -> None:
    pad = Keypad()
    for _ in range(20):
        assert pad.press("+", 0.0)
    assert pad.speed_m_s == SPEEDS[-1]
    for _ in range(20):
        pad.press("-", 0.0)
    assert pad.speed_m_s == SPEEDS[0]
    pad.press("A", 0.0)
    assert pad.velocity(0.0).left_m_s == SPEEDS[0]
