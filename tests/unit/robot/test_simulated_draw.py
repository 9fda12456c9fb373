"""What simulated servos draw: waiting, holding, moving, and under the torques of a simulated body."""

import pytest

from gateway.robot.power.currents import IDLE_MA
from gateway.simulation.board_port import HOLDS_MA, WAITS_MA, SimulatedDraw
from schemas.robot import SERVO_IDS

MS = 1_000_000  # ns
OFF: dict[int, float | None] = dict.fromkeys(SERVO_IDS)


def test_one_that_is_driven_holds_and_takes_more_until_it_is_there() -> None:
    draw = SimulatedDraw()
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 0) == {**dict.fromkeys(SERVO_IDS, WAITS_MA), 21: 450.0}
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 84 * MS)[21] == 450.0, "30 degrees take 85 ms"
    assert draw.draw_ma({**OFF, 21: 60.0}, (), 86 * MS)[21] == HOLDS_MA
    assert draw.draw_ma({**OFF, 21: 61.0}, (), 100 * MS)[21] == 450.0
    assert draw.draw_ma(OFF, (), 101 * MS)[21] == WAITS_MA


def test_one_that_holds_though_it_was_stopped_draws_more_than_a_stopped_one_may() -> None:
    assert WAITS_MA < IDLE_MA < HOLDS_MA


def test_a_bodys_torques_decide() -> None:
    torques_nm = [0.0] * 18
    torques_nm[SERVO_IDS.index(22)] = -2.0
    drawn = SimulatedDraw().draw_ma(dict.fromkeys(SERVO_IDS, 90.0) | {63: None}, torques_nm, 0)
    assert drawn == {**dict.fromkeys(SERVO_IDS, 10.0), 22: pytest.approx(2510.0), 63: WAITS_MA}
