"""Stops to legs at rest (*Legs at rest*): a servo that nobody started does not stay on."""

import asyncio
from itertools import pairwise

import pytest

from gateway.allowance import NS_PER_MS
from gateway.model.frames import stop_leg
from gateway.model.framing import Framing
from gateway.robot.core.events import Transmit
from gateway.robot.core.leg import Rules
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from tests.support.robot import MS, Robot, leg, started_and_quiet
from tests.support.steps import Steps, leg_to, legs_to, servo_to, staggered
from tests.support.transfers import on_wire, preamble_of

LEG_3, LEG_4 = keys.leg_command(3), keys.leg_command(4)
PREFIXED = Framing.LENGTH_PREFIXED
SET = leg("set", 10, 10, 10)


def stopped_too(robot: Steps) -> list[int]:
    """The legs at rest that get a Stop behind the step's first Stops."""
    joining = robot.joining
    stops = [effect for effect in robot.effects if isinstance(effect, Transmit) and effect.frame.is_stop]
    assert stops[len(stops) - len(joining) :] == joining, "first Stops come first"
    return [effect.frame.servos[0][0] // 10 for effect in joining]


# ---- when, and to whom


def test_legs_at_rest_are_stopped_with_a_silent_leg_and_those_that_run_are_not() -> None:
    robot = Steps()
    robot.command(100, leg_to(1, "start 90"))
    robot.command(200, leg_to(2, "start 90"))
    assert robot.time(350) == ["watchdog 1 stop", "announce watchdog_expired"]
    assert stopped_too(robot) == [3, 4, 5, 6]
    assert robot.running == [21, 22, 23]


def test_a_leg_whose_stop_is_to_be_repeated_gets_no_other() -> None:
    robot = Steps(Rules(repeats=1, repeat_interval_ns=20 * NS_PER_MS))
    robot.time(20)
    for number in (1, 2, 3):
        robot.command(100 + number, leg_to(number, "start 90"))
    robot.time(351)
    assert stopped_too(robot) == [4, 5, 6]
    robot.time(352)
    assert stopped_too(robot) == []


def test_while_others_run_each_leg_at_rest_gets_a_stop_every_800_ms() -> None:
    robot = Steps(Rules(repeats=0, timeout_ns=10_000 * NS_PER_MS))
    robot.command(100, legs_to("1", "start 90"))
    robot.command(800, servo_to(21, "start 90"))
    assert robot.due_ms == 900
    assert robot.time(899) == []
    assert robot.time(900) == [f"repeat {number} stop" for number in (3, 4, 5, 6)]
    assert robot.due_ms == 1700


def test_a_service_that_ends_waits_for_no_further_run() -> None:
    robot = Steps(Rules(repeats=0))
    robot.command(100, leg_to(1, "start 90"))
    robot.command(200, leg_to(1, "stop"))
    assert robot.due_ms is not None
    robot.end(300)
    assert robot.due_ms is None


def test_the_rounds_go_on_at_their_time_however_many_commands_come() -> None:
    robot = Steps()
    robot.command(10, leg_to(1, "start 90"))
    for at_ms in range(50, 800, 50):
        assert robot.command(at_ms, leg_to(1, "set 80"))[:1] == ["command 1 set 80"]
    assert robot.command(810, leg_to(1, "set 80"))[:5] == [f"repeat {number} stop" for number in range(2, 7)]


def test_a_start_in_the_step_of_a_round_is_not_undone() -> None:
    robot = Steps()
    robot.command(10, leg_to(1, "start 90"))
    for at_ms in range(200, 800, 200):
        robot.command(at_ms, leg_to(1, "set 90"))
    assert robot.command(810, leg_to(2, "start 90")) == [
        "repeat 3 stop",
        "repeat 4 stop",
        "repeat 5 stop",
        "repeat 6 stop",
        "command 2 start 90",
        "completed 5",
    ]


def test_where_all_legs_run_there_is_no_round() -> None:
    robot = Steps(Rules(repeats=0, timeout_ns=10_000 * NS_PER_MS))
    robot.command(10, legs_to("123456", "start 90"))
    assert robot.due_ms == 10_010


def test_the_last_stop_is_one_for_all_legs_with_its_repeats() -> None:
    robot = Steps(Rules(repeats=1, repeat_interval_ns=20 * NS_PER_MS, rest_runs=0))
    robot.time(20)
    robot.command(100, leg_to(1, "start 90"))
    robot.command(101, servo_to(21, "start 90"))
    robot.command(200, leg_to(1, "stop"))
    assert stopped_too(robot) == [], "leg 2 runs on"
    assert robot.command(210, servo_to(21, "stop")) == ["command 21 stop", "completed 4"]
    assert stopped_too(robot) == [2, 3, 4, 5, 6], "leg 1's is still to be repeated"
    assert robot.due_ms == 220, "where it was, and the others go with it: one run, with one preamble"
    assert robot.time(220) == [f"repeat {number} stop" for number in LEGS]
    assert robot.due_ms is None, "at rest nothing is due"


def test_a_leg_that_waits_to_be_started_gets_none() -> None:
    robot = staggered(50)
    robot.command(100, legs_to("12", "start 90"))
    robot.command(110, (*leg_to(1, "stop"), *leg_to(3, "start 90")))
    assert stopped_too(robot) == [2, 4, 5, 6], "leg 2's start is dropped, and leg 3's waits"


def test_a_round_uses_no_rate_slot_and_the_state_says_what_it_said() -> None:
    robot = Steps()
    robot.command(10, leg_to(2, "start 90"))
    robot.time(260)
    robot.command(300, leg_to(1, "start 90"))
    slots = [each.slots.next_ns for each in robot.supervisor.legs]
    robot.time(550)
    assert stopped_too(robot) == [2, 3, 4, 5, 6]
    assert [each.slots.next_ns for each in robot.supervisor.legs] == slots
    assert [each.watchdog for each in robot.supervisor.legs][:3] == ["expired", "expired", "idle"]


# ---- more runs, once nothing runs

RUN_MS = 1100
REPEATED = [f"repeat {number} stop" for number in LEGS]
SINGLY = [f"repeat {servo_id} stop" for servo_id in SERVO_IDS]


def at_rest() -> Steps:
    """Opened at 0 ms, and nothing is owed any more at 5000 ms."""
    robot = Steps(Rules(repeats=3))
    assert runs_of(robot) == [20, 40, 60, *(60 + RUN_MS * run for run in (1, 2, 3, 4))], "after the Stops at the start"
    return robot


def runs_of(robot: Steps) -> list[float]:
    """Wake it up as it wants, until it wants nothing any more: when all legs got Stops, each servo's own at last."""
    found = []
    words: list[str] = []
    while robot.due_ms is not None:
        due_ms = robot.due_ms
        words = robot.time(due_ms)
        if words in (REPEATED, SINGLY):
            found += [due_ms]
        assert words != SINGLY or robot.due_ms is None
    assert words == SINGLY or robot.supervisor.legs.rest.runs == 0
    return found


@pytest.mark.parametrize("how", ["emergency stop", "stop", "one servo's stop", "silence", "stop-servos", "power"])
def test_three_more_runs_follow_whatever_brings_the_last_leg_to_rest(how: str) -> None:
    robot = at_rest()
    at_ms = 5010.0
    if how == "one servo's stop":
        robot.command(5000, servo_to(11, "start 90"))
        robot.command(at_ms, servo_to(11, "stop"))
    else:
        robot.command(5000, leg_to(1, "start 90"))
        if how == "emergency stop":
            robot.estop(at_ms)
        elif how == "stop":
            robot.command(at_ms, leg_to(1, "stop"))
        elif how == "silence":
            robot.time(at_ms := 5250)
        elif how == "stop-servos":
            robot.outside(at_ms, at_work=True)
        else:
            robot.board(at_ms, doubt="it is not confirmed")
    assert [round(each - at_ms) for each in runs_of(robot)] == [20, 40, 60, 1160, 2260, 3360, 4460]


@pytest.mark.parametrize("how", ["emergency stop", "stop", "bus"])
def test_three_more_runs_follow_a_stop_of_a_robot_at_rest(how: str) -> None:
    """Bytes of it may be lost, too."""
    robot = at_rest()
    if how == "emergency stop":
        robot.estop(5010)
    elif how == "stop":
        robot.command(5010, servo_to(11, "stop"))
    else:
        robot.fail(5000)
        robot.open(5010)
    assert [round(each - 5010) for each in runs_of(robot)][-4:] == [1160, 2260, 3360, 4460]


def test_repeats_that_take_long_are_over_before_the_first_of_them() -> None:
    robot = Steps(Rules(repeats=2, repeat_interval_ns=1000 * NS_PER_MS))
    assert runs_of(robot) == [1000, 2000, 3100, 4200, 5300, 6400]


def test_a_run_that_is_late_moves_the_next_one_and_none_is_lost() -> None:
    robot = at_rest()
    robot.estop(5000)
    for at_ms in (5020, 5040, 5060, 6500):
        assert robot.time(at_ms) == REPEATED
    assert runs_of(robot) == [7600, 8700, 9800], "at least a second apart"


def test_a_stop_while_they_are_owed_moves_none_and_three_more_are_far_enough_behind_it() -> None:
    robot = at_rest()
    robot.estop(5000)
    for at_ms in (5020, 5040, 5060):
        assert robot.time(at_ms) == REPEATED
    robot.estop(6150)
    assert runs_of(robot) == [6170, 6190, 6210, 7310, 8410, 9510, 10_610], "6160 is among its repeats"
    robot.estop(12_000)
    robot.time(12_020)
    robot.estop(13_000)
    runs = runs_of(robot)
    assert 13_160 in runs, "where it was"
    assert [each for each in runs if each >= 13_060 + 1000] == [14_260, 15_360, 16_460, 17_560]


def test_a_start_ends_them_and_waits_for_none() -> None:
    robot = at_rest()
    robot.estop(5000)
    for at_ms in (5020, 5040, 5060):
        assert robot.time(at_ms) == REPEATED
    robot.reset(5100)
    assert robot.due_ms == 6160
    assert robot.command(6160, leg_to(1, "start 90")) == ["command 1 start 90", "completed 2"]
    assert robot.command(6300, leg_to(1, "set 90")) == ["command 1 set 90", "completed 3"]
    assert robot.due_ms == 6550, "the watchdog's time"
    for at_ms in range(6500, 6960, 200):
        assert robot.command(at_ms, leg_to(1, "set 90"))[0] == "command 1 set 90"
    assert robot.time(6960) == REPEATED[1:], "0.8 s behind its start, to the others"


def test_a_leg_that_waits_to_be_started_gets_none_of_them() -> None:
    robot = Steps(Rules(repeats=0, start_pause_ns=50 * NS_PER_MS, period_ns=400 * NS_PER_MS))
    robot.command(800, leg_to(1, "start 90"))
    robot.command(810, leg_to(1, "stop"))
    assert robot.due_ms == 1910, "legs 2 to 6 have been at rest since 0 ms, and got a Stop at 810"
    robot.command(850, leg_to(1, "start 90"))
    robot.command(860, leg_to(1, "stop"))
    assert robot.command(1900, leg_to(1, "start 90")) == ["command 1 start 90", "completed 5"]


def test_a_start_that_waits_is_not_stopped_by_a_run() -> None:
    robot = Steps(Rules(repeats=0, period_ns=1000 * NS_PER_MS, timeout_ns=10_000 * NS_PER_MS))
    robot.command(100, leg_to(1, "start 90"))
    for at_ms in (350, 600):  # the bucket's other slots
        robot.command(at_ms, leg_to(1, "set 90"))
    robot.command(610, leg_to(1, "stop"))
    assert robot.command(1000, leg_to(1, "start 80")) == []
    assert robot.time(1100) == ["command 1 start 80", "completed 5"]


def test_the_end_waits_for_none_of_them() -> None:
    robot = at_rest()
    robot.command(5000, leg_to(1, "start 90"))
    robot.end(5010)
    assert runs_of(robot) == [5030, 5050, 5070]


# ---- nothing that is owed moves to a later time


@pytest.mark.parametrize("every_ms", [1, 15, 19, 20, 21])
def test_a_repeat_comes_in_its_time_however_often_others_are_stopped(every_ms: int) -> None:
    """Five legs that are started and stopped in turn; leg 2 is at rest, and has its Stop when the others come to it."""
    robot = at_rest()
    robot.command(5000, leg_to(2, "start 90"))
    robot.command(5001, leg_to(2, "stop"))
    since_ms = gap_ms = 5001.0
    longest_ms = 0.0
    for turn in range(400):
        at_ms = 5002.0 + every_ms * turn
        while robot.due_ms is not None and robot.due_ms < at_ms:
            due_ms = robot.due_ms
            if "repeat 2 stop" in robot.time(due_ms):
                gap_ms, since_ms = due_ms - since_ms, due_ms
                longest_ms = max(longest_ms, gap_ms)
        number = (1, 3, 4, 5, 6)[turn // 2 % 5]
        words = robot.command(at_ms, leg_to(number, "stop" if turn % 2 else "start 90"))
        if "repeat 2 stop" in words:
            gap_ms, since_ms = at_ms - since_ms, at_ms
            longest_ms = max(longest_ms, gap_ms)
    assert longest_ms <= 20 + every_ms
    assert at_ms - since_ms <= 20 + every_ms


def test_stops_that_keep_coming_postpone_no_repeat_and_no_run() -> None:
    robot = at_rest()
    robot.command(5000, legs_to("123456", "stop"))
    repeats: list[float] = []
    runs: list[float] = []
    for at_ms in range(5010, 12_000, 10):
        words = robot.command(at_ms, leg_to(1, "stop")) if at_ms % 30 == 10 else robot.time(at_ms)
        repeats += [at_ms] * ("repeat 1 stop" in words)
        runs += [at_ms] * ("repeat 6 stop" in words)
    assert runs[:3] == [5020, 5040, 5060]
    assert len(runs) == 3 + 6
    assert max(later - earlier for earlier, later in pairwise(runs)) <= RUN_MS + 60
    assert max(later - earlier for earlier, later in pairwise(repeats)) <= 20


def test_emergency_stops_that_keep_coming_postpone_no_repeat() -> None:
    robot = at_rest()
    repeats: list[float] = []
    for at_ms in range(5000, 6000, 5):
        robot.estop(at_ms)
        repeats += [at_ms] * (robot.time(at_ms) == REPEATED)
    assert max(later - earlier for earlier, later in pairwise(repeats)) == 20


def test_a_start_that_is_dropped_again_and_again_does_not_postpone_the_round() -> None:
    """Of leg 6, the only one at rest: it waits to be started, and a Stop elsewhere ends that."""
    second = 1000 * NS_PER_MS
    robot = Steps(Rules(repeats=0, rest_runs=0, timeout_ns=10 * second, start_pause_ns=second))
    for number in range(1, 6):
        assert f"command {number} start 90" in robot.command(1000 * number - 900, leg_to(number, "start 90"))
        while number < 5 and robot.due_ms is not None and robot.due_ms < 1000 * number + 100:
            robot.time(robot.due_ms)
    for at_ms in range(4200, 4900, 100):
        assert robot.command(at_ms, leg_to(6, "start 90")) == []
        robot.command(at_ms + 50, servo_to(11, "stop"))
    assert robot.time(4900) == ["repeat 6 stop"], "0.8 s behind the one before"


def test_a_bus_that_opens_again_owes_the_repeats_of_its_own_stops() -> None:
    robot = at_rest()
    robot.estop(5000)
    robot.time(5020)
    robot.fail(5025)
    robot.open(5050)
    assert runs_of(robot)[:3] == [5070, 5090, 5110]


# ---- on the wire, where a controller loses five bytes


async def walking() -> Robot:
    """Legs 3 and 4 walk, and servo 21 runs: of leg 3's Set five bytes were lost, and leg 4's frame came behind it."""
    spi = {"framing": PREFIXED}
    robot = await started_and_quiet(spi=spi)
    await asyncio.sleep(1)
    for key in (LEG_3, LEG_4):
        robot.put(key, leg("start", 10, 10, 10))
    await walk(robot, 0.1)
    robot.controller.lose_bytes(5, behind=1 + 9)
    await walk(robot, 0.02)
    assert robot.controller.energised == {21, 31, 32, 33, 41, 42, 43}
    return robot


async def walk(robot: Robot, seconds: float, *legs: str) -> None:
    """Setpoints at 50 Hz."""
    for _ in range(round(seconds * 50)):
        await asyncio.sleep(0.02)
        for key in legs or (LEG_3, LEG_4):
            robot.put(key, SET)


@pytest.mark.virtual_time
async def test_a_servo_that_nobody_started_is_off_within_a_second_while_others_walk() -> None:
    robot = await walking()
    await walk(robot, 0.9)
    assert robot.controller.energised == {31, 32, 33, 41, 42, 43}


@pytest.mark.virtual_time
async def test_it_is_off_when_a_leg_is_silent() -> None:
    robot = await walking()
    await walk(robot, 0.3, LEG_4)
    assert robot.controller.energised == {41, 42, 43}


@pytest.mark.virtual_time
async def test_it_is_off_when_all_come_to_rest() -> None:
    robot = await walking()
    for key in (LEG_3, LEG_4):
        robot.put(key, leg("stop"))
    await asyncio.sleep(0.03)  # the first repeat: the controller may be out of sync until its preamble
    assert robot.controller.energised == set()


@pytest.mark.virtual_time
async def test_they_leave_with_the_first_stop_and_no_preamble_between() -> None:
    robot = await started_and_quiet(spi={"framing": PREFIXED})
    robot.put(LEG_3, leg("start", 10, 10, 10))
    robot.controller.transfers.clear()
    calls = sum(robot.conductor.bus.transfer_latency.buckets)
    robot.put(LEG_3, leg("stop"))
    others = [stop_leg(number) for number in LEGS if number != 3]
    assert [data for _, data in robot.controller.transfers] == on_wire(PREFIXED, stop_leg(3), *others)
    assert sum(robot.conductor.bus.transfer_latency.buckets) == calls + 1


@pytest.mark.virtual_time
async def test_a_round_finds_its_preamble_written_and_is_the_streams_only_one() -> None:
    robot = await started_and_quiet(spi={"framing": PREFIXED})
    await asyncio.sleep(1)
    robot.put(LEG_3, leg("start", 10, 10, 10))
    robot.controller.transfers.clear()
    begun_ns = robot.now_ns()
    await walk(robot, 2.5, LEG_3)
    data = [data for _, data in robot.controller.transfers]
    stops = on_wire(PREFIXED, *(stop_leg(number) for number in LEGS if number != 3))
    found = [index for index in range(len(data)) if data[index : index + len(stops)] == stops]
    assert [round((robot.controller.transfers[index][0] - begun_ns) / MS) for index in found] == [800, 1600, 2400]
    for index in found:
        assert data[index - 16 : index] == preamble_of(PREFIXED)
    assert data.count(b"\0") == 3 * 16
