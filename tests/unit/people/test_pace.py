"""The grid of a stream's setpoints: no drift, no bursts, what was missed is counted; and when the gateway is asked."""

import doctest
import random

import pytest

from gateway.people.client import pace as pace_module
from gateway.people.client.pace import LATE_PART, MOST_DEG, RADIANS_S, SILENCE_S, Doubt, Radians, SetpointPace

BEGUN_S = 1000.0
PERIOD_S = 0.02


def begun() -> SetpointPace:
    pace = SetpointPace(1 / PERIOD_S)
    pace.begin(BEGUN_S)
    return pace


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
        assert sent_s[-1] - due_s <= LATE_PART * PERIOD_S + 1e-6
        assert sent_s[-1] - sent_s[-2] >= (1 - LATE_PART) * PERIOD_S - 1e-6
    assert pace.missed > 1000


WATCHDOG_S = 0.25


def streaming() -> Doubt:
    """A stream that has just sent, and just received."""
    doubt = Doubt(WATCHDOG_S)
    doubt.sent(BEGUN_S)
    doubt.received(BEGUN_S)
    return doubt


def test_a_gateway_that_publishes_nothing_for_half_a_second_is_asked() -> None:
    doubt = streaming()
    for late_s, is_there in ((SILENCE_S - 0.001, False), (SILENCE_S, True), (60.0, True)):
        doubt.sent(BEGUN_S + late_s)  # the program goes on
        assert doubt.is_there(BEGUN_S + late_s) is is_there
    doubt.received(BEGUN_S + 60)
    assert not doubt.is_there(BEGUN_S + 60)
    assert SILENCE_S == 0.5


def test_the_examples_are_right() -> None:
    assert doctest.testmod(pace_module) == (0, 16)


def test_radians_are_suspected_once_and_never_of_a_program_that_has_sent_degrees() -> None:
    radians = Radians()
    assert [radians.suspected([(MOST_DEG, 0.0)], now_s) for now_s in (0.0, RADIANS_S, RADIANS_S + 1)] == [
        False,
        True,
        False,
    ]
    degrees = Radians()
    assert not any(degrees.suspected([(angle,)], now_s) for angle, now_s in ((MOST_DEG + 0.01, 0), (1, 9), (1, 99)))
    late = Radians()
    late.suspected([(1.0,)], 0.0)
    late.suspected([(90.0,)], 0.1)
    assert not late.suspected([(1.0,)], RADIANS_S)
