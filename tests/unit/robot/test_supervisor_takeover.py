"""A servo that another source commands, or that is started soon behind its Stop, has a takeover's speed until it has
arrived. The oracle judges each step."""

from itertools import pairwise

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.calibration import CalibrationChange, MappingChange
from gateway.robot.core.leg import Rules
from gateway.robot.core.supervisor import Supervisor
from tests.support.steps import Steps, Targets, all_stopped, leg_to, servo_to

RULES = Rules(repeats=0, rest_runs=0, takeover_cdeg_s=180_00)
SLOT_DEG = 180 / 50


def annas(rules: Rules = RULES) -> Steps:
    """Anna's program has started servo 31 at 20 degrees at 0 ms, and holds it there."""
    steps = Steps(rules)
    for at_ms in (1, 100, 200):
        steps.command(at_ms, leg_to(3, "start 20"), source="anna")
    return steps


def told(lines: list[str]) -> list[float]:
    """What servo 31 is told in these effects."""
    frames = [line.split() for line in lines if line.startswith(("command 3", "watchdog 3")) and "stop" not in line]
    return [float(words[3]) for words in frames if words[1] in ("3", "31")]


def streamed(steps: Steps, target: str, source: str, ms: range) -> list[float]:
    """A program sets servo 31 every 20 ms: what the servo is told."""
    return [deg for at_ms in ms for deg in told(steps.command(at_ms, servo_to(31, target), source=source))]


def test_a_second_program_moves_a_servo_no_faster_than_a_takeover_may() -> None:
    steps = annas()
    said = streamed(steps, "set 160", "bert", range(220, 1200, 20))
    assert all(0 < later - earlier <= SLOT_DEG + 0.001 for earlier, later in pairwise(said) if later < 160)
    assert said[0] == pytest.approx(20 + SLOT_DEG)
    assert said[-1] == 160
    assert 140 / 180 * 1000 - 40 < 20 * said.index(160) < 140 / 180 * 1000 + 60


@pytest.mark.parametrize(("takeover_cdeg_s", "first"), [(180_00, 20.9), (1, 20)])
def test_its_first_step_counts_from_the_frame_before(takeover_cdeg_s: int, first: float) -> None:
    steps = annas(Rules(repeats=0, rest_runs=0, takeover_cdeg_s=takeover_cdeg_s))
    assert streamed(steps, "set 160", "bert", range(205, 206)) == [pytest.approx(first)]


def test_once_it_has_arrived_it_is_as_quick_as_ever() -> None:
    steps = annas()
    streamed(steps, "set 30", "bert", range(220, 400, 20))
    assert streamed(steps, "set 170", "bert", range(400, 420, 20)) == [170]


def test_a_program_that_begins_where_the_servo_stands_has_arrived() -> None:
    steps = annas()
    assert streamed(steps, "set 20", "bert", range(220, 240, 20)) == [20]
    assert streamed(steps, "set 90", "bert", range(240, 260, 20)) == [90]


def test_the_same_source_leaps_as_ever() -> None:
    assert streamed(annas(), "set 160", "anna", range(220, 240, 20)) == [160]


def test_two_programs_that_take_a_servo_from_each_other_in_turn_move_it_no_faster() -> None:
    steps = annas()
    said = [20.0]
    for at_ms in range(220, 1000, 20):
        source, target = (("anna", "set 20"), ("bert", "set 160"))[at_ms // 20 % 2]
        said += told(steps.command(at_ms, servo_to(31, target), source=source))
    assert max(abs(later - earlier) for earlier, later in pairwise(said)) <= SLOT_DEG + 0.001


def test_each_servo_has_a_source_of_its_own() -> None:
    steps = annas()
    steps.command(220, servo_to(32, "set 120"), source="bert")
    assert steps.command(240, leg_to(3, "set 100"), source="anna")[0].startswith("command 3 set 100 | set 2")


@pytest.mark.parametrize("stopped_by", ["a stop", "an emergency stop"])
def test_a_start_soon_behind_a_stop_begins_where_the_servo_stands(stopped_by: str) -> None:
    steps = annas()
    if stopped_by == "a stop":
        steps.command(220, leg_to(3, "stop"), source="anna")
    else:
        steps.estop(220)
        steps.reset(221)
    assert steps.command(270, leg_to(3, "start 35"), source="anna")[0] == "command 3 start 20"
    said = [deg for at_ms in range(290, 500, 20) for deg in told(steps.time(at_ms))]
    assert said[0] == pytest.approx(20 + SLOT_DEG)
    assert said[-1] == 35


@pytest.mark.parametrize(("later_ms", "first"), [(2000, 20), (2001, 160)])
def test_two_seconds_behind_its_stop_nobody_knows_where_it_hangs(later_ms: int, first: int) -> None:
    steps = annas()
    steps.command(220, leg_to(3, "stop"), source="anna")
    steps.time(1000)
    assert steps.command(220 + later_ms, leg_to(3, "start 160"), source="anna")[0] == f"command 3 start {first}"


def test_of_a_leg_only_the_servo_that_ran_begins_where_it_stands() -> None:
    steps = Steps(RULES)
    steps.command(1, servo_to(32, "start 20"), source="anna")
    steps.command(40, servo_to(32, "stop"), source="anna")
    assert steps.command(80, leg_to(3, "start 35"), source="anna")[0] == "command 3 start 35 | start 20 | start 35"


def test_what_never_ran_starts_where_it_is_told() -> None:
    assert Steps(RULES).command(1, servo_to(31, "start 160"), source="anna")[0] == "command 31 start 160"


def test_behind_another_calibration_an_angle_means_another_place() -> None:
    steps = annas()
    steps.command(220, leg_to(3, "stop"), source="anna")
    steps.calibrate(230, CalibrationChange({31: MappingChange(trim_cdeg=10_00)}, {}))
    steps.kept(240)
    assert steps.command(270, servo_to(31, "start 150"), source="anna")[0] == "command 31 start 160", "its own angle"


def test_behind_a_fault_of_the_bus_nobody_knows_which_frame_was_the_last() -> None:
    steps = annas()
    steps.command(220, servo_to(31, "set 25"), source="anna")
    steps.fail(220)
    steps.open(240)
    assert steps.command(270, leg_to(3, "start 35"), source="anna")[0] == "command 3 start 35"


def test_switched_off_nothing_of_it_happens() -> None:
    steps = annas(Rules(repeats=0, rest_runs=0))
    assert streamed(steps, "set 160", "bert", range(220, 240, 20)) == [160]
    steps.command(240, leg_to(3, "stop"), source="bert")
    assert steps.command(280, leg_to(3, "start 35"), source="bert")[0] == "command 3 start 35"


def test_a_servo_whose_own_speed_is_lower_keeps_it() -> None:
    steps = annas(Rules(repeats=0, rest_runs=0, takeover_cdeg_s=180_00, max_speed_cdeg_s={31: 50_00}))
    said = streamed(steps, "set 160", "bert", range(220, 400, 20))
    assert max(later - earlier for earlier, later in pairwise(said)) <= 1.01


@pytest.mark.parametrize("how", ["stop", "estop", "silence"])
def test_a_stop_ends_it(how: str) -> None:
    steps = annas()
    steps.command(220, servo_to(31, "set 160"), source="bert")
    if how == "stop":
        assert steps.command(230, leg_to(3, "stop"), source="anna")[0] == "command 3 stop"
    elif how == "estop":
        assert steps.estop(230)[:6] == all_stopped("estop")
    else:
        while steps.running:
            assert steps.due_ms is not None
            last_ms = steps.due_ms
            steps.time(steps.due_ms)
        assert last_ms == 470, "its own steps feed no watchdog"
    assert not told(steps.time(700))


def test_a_landing_keeps_a_pace_of_its_own() -> None:
    steps = annas(
        Rules(repeats=0, rest_runs=0, takeover_cdeg_s=10_00, landing_ns=500 * NS_PER_MS, landing_cdeg={31: 90_00})
    )
    steps.command(220, servo_to(31, "set 160"), source="bert")
    said = [deg for at_ms in range(240, 960, 20) for deg in told(steps.time(at_ms))]
    assert said[-1] == 90


def test_starts_wait_for_each_other_and_an_emergency_stop_for_nothing() -> None:
    everything: Targets = tuple(target for leg in range(1, 7) for target in leg_to(leg, "start 90"))
    steps = Steps(Rules(repeats=0, rest_runs=0, start_pause_ns=15 * NS_PER_MS))
    assert steps.command(1, everything) == ["command 1 start 90"]
    assert [steps.time(1 + 15 * each)[0] for each in range(1, 3)] == ["command 2 start 90", "command 3 start 90"]
    assert steps.estop(32) == [*all_stopped("estop"), "rejected 1 estopped", "announce estop_engaged"]
    assert not [line for line in steps.time(100) if "start" in line]


def stopped_at_20_degrees(*, supply_starts: bool) -> Steps:
    """Servo 31 of a robot with a power board ran until 100 ms."""
    steps = Steps(Rules(repeats=0, rest_runs=0, power=True, angles_first=supply_starts, takeover_cdeg_s=180_00))
    steps.board(1, fed=())
    steps.command(10, servo_to(31, "start 20"), source="anna")
    steps.board(20)
    steps.command(100, servo_to(31, "stop"), source="anna")
    steps.board(110, fed=())
    return steps


def test_a_board_whose_supply_starts_a_servo_feeds_it_at_the_angle_where_it_stands() -> None:
    steps = stopped_at_20_degrees(supply_starts=True)
    robot: Supervisor = steps.supervisor
    steps.command(150, servo_to(31, "start 160"), source="anna")
    assert robot.to_feed() == {31: 20_00}
    steps.command(160, servo_to(31, "set 170"), source="anna")
    assert steps.board(200)[0] == "command 31 start 20"
    assert told(steps.time(220)) == [pytest.approx(20 + SLOT_DEG)]


@pytest.mark.parametrize(("supply_starts", "at_cdeg"), [(True, 20_00), (False, 170_00)])
def test_the_angle_at_which_supply_starts_a_servo_stays_however_long_it_waits(
    supply_starts: bool, at_cdeg: int
) -> None:
    steps = stopped_at_20_degrees(supply_starts=supply_starts)
    steps.command(1500, servo_to(31, "start 160"), source="anna")
    steps.command(2150, servo_to(31, "set 170"), source="bert")
    assert steps.supervisor.to_feed() == {31: at_cdeg}
