"""What currents say about Stops."""

import pytest

from gateway.allowance import NS_PER_MS
from gateway.robot.power.board import News
from gateway.robot.power.currents import CurrentRules
from schemas.telemetry import Kind

NONE: frozenset[int] = frozenset()


class Robot:
    """Servo 11 (and what else is given), measured every 65 ms, as the board's questions go round."""

    def __init__(self) -> None:
        self.rules = CurrentRules()
        self.now_ns = 0

    def measure(self, ma: float, *, ms: float, runs: bool) -> list[News]:
        news: list[News] = []
        end_ns = self.now_ns + round(ms * NS_PER_MS)
        while self.now_ns < end_ns:
            news += self.rules.measured({11: ma, 12: 100.0}, frozenset({11, 12} if runs else NONE), self.now_ns)
            self.now_ns += 65 * NS_PER_MS
        return news


def test_a_stopped_servo_that_still_draws_is_named_once_and_again_after_the_next_stop() -> None:
    robot = Robot()
    assert robot.measure(900, ms=2000, runs=True) == []
    [news] = robot.measure(900, ms=3000, runs=False)
    assert news == News(Kind.SERVO_DRAWS, "servo 11 is stopped and draws 900 mA, more than 150 mA", frozenset({11}))
    robot.measure(900, ms=200, runs=True)
    assert len(robot.measure(900, ms=3000, runs=False)) == 1


def test_a_stopped_servo_may_draw_while_it_settles_and_no_more_than_idle_after() -> None:
    robot = Robot()
    robot.measure(900, ms=500, runs=True)
    assert robot.measure(900, ms=300, runs=False) == []
    assert robot.measure(150, ms=5000, runs=False) == []


def test_one_measurement_alone_takes_no_supply() -> None:
    robot = Robot()
    robot.measure(0, ms=1000, runs=False)
    for _ in range(10):
        assert robot.measure(5000, ms=1, runs=False) == []
        assert robot.measure(20, ms=1, runs=False) == []


def test_what_was_never_started_is_judged_too() -> None:
    assert len(Robot().measure(900, ms=600, runs=False)) == 1


@pytest.mark.parametrize(("ma", "ms", "events"), [(0, 900, 0), (0, 3000, 1), (4, 3000, 1), (5, 3000, 0), (8, 3000, 0)])
def test_a_servo_that_runs_and_draws_nothing_for_a_second_is_named_once(ma: float, ms: float, events: int) -> None:
    news = Robot().measure(ma, ms=ms, runs=True)
    assert [item.kind for item in news] == [Kind.SERVO_SILENT] * events
    assert all(item.servos == {11} for item in news)


def test_a_pause_of_its_silence_begins_the_second_anew() -> None:
    robot = Robot()
    for _ in range(5):
        assert robot.measure(0, ms=900, runs=True) == []
        assert robot.measure(30, ms=1, runs=True) == []


def test_the_second_measurement_behind_the_time_to_settle_takes_the_supply() -> None:
    rules = CurrentRules()
    end_ns = 300 * NS_PER_MS
    early = [rules.measured({11: 151.0}, NONE, at_ns) for at_ns in range(0, end_ns, 10 * NS_PER_MS)]
    assert not any(early)
    assert rules.measured({11: 151.0}, NONE, end_ns) == []
    assert [each.kind for each in rules.measured({11: 151.0}, NONE, end_ns + 1)] == [Kind.SERVO_DRAWS]


def test_a_servo_that_draws_nothing_is_silent_after_a_second() -> None:
    rules, running = CurrentRules(), frozenset({11})
    found = [rules.measured({11: 0.0}, running, at_ms * NS_PER_MS) for at_ms in (7, 8, 1006, 1007, 1008)]
    assert [len(news) for news in found] == [0, 0, 0, 1, 0]
