"""The grid of a stream's setpoints: no drift, no bursts, and what was missed is counted."""

import random

import pytest

from gateway.people.client.stream import LATE, Pace

BEGUN_S = 1000.0
PERIOD_S = 0.02


def begun() -> Pace:
    pace = Pace(1 / PERIOD_S)
    pace.begin(BEGUN_S)
    return pace


def test_before_the_first_nothing_is_due() -> None:
    pace = Pace(50)
    assert pace.next_s(7.0) == 7.0
    assert pace.missed == 0


def test_work_between_two_setpoints_does_not_move_the_grid() -> None:
    pace = begun()
    now_s = BEGUN_S
    for tick in range(1, 100_001):
        due_s = pace.next_s(now_s + 0.7 * PERIOD_S)
        assert due_s == pytest.approx(BEGUN_S + tick * PERIOD_S, abs=1e-6)
        now_s = due_s + 0.2 * PERIOD_S  # the sleep that ends late
    assert pace.missed == 0


@pytest.mark.parametrize(
    ("late_periods", "tick", "missed"),
    [(-0.9, 1, 0), (0.0, 1, 0), (0.4, 1, 0), (0.6, 2, 1), (1.4, 2, 1), (1.6, 3, 2), (50.0, 51, 50)],
)
def test_what_is_late_is_skipped_and_counted(late_periods: float, tick: int, missed: int) -> None:
    pace = begun()
    assert pace.next_s(BEGUN_S + (1 + late_periods) * PERIOD_S) == pytest.approx(BEGUN_S + tick * PERIOD_S)
    assert pace.missed == missed
    assert pace.next_s(BEGUN_S + tick * PERIOD_S) == pytest.approx(BEGUN_S + (tick + 1) * PERIOD_S)


def test_after_any_stalls_there_is_no_burst_and_no_drift() -> None:
    """Every tick is either one setpoint's or missed, and two setpoints are at least half a period apart."""
    dice = random.Random(1)  # noqa: S311
    pace = begun()
    sent_s = [BEGUN_S]
    for _ in range(10_000):
        ready_s = sent_s[-1] + dice.expovariate(1 / PERIOD_S)
        due_s = pace.next_s(ready_s)
        sent_s.append(max(ready_s, due_s))
        assert due_s == pytest.approx(BEGUN_S + (len(sent_s) - 1 + pace.missed) * PERIOD_S, abs=1e-6)
        assert sent_s[-1] - due_s <= LATE * PERIOD_S + 1e-6
        assert sent_s[-1] - sent_s[-2] >= (1 - LATE) * PERIOD_S - 1e-6
    assert pace.missed > 1000


def test_a_pause_misses_nothing() -> None:
    pace = begun()
    pace.pause()
    assert pace.next_s(BEGUN_S + 60) == BEGUN_S + 60
    assert pace.missed == 0
