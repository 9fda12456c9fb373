"""The power board under the service, in virtual time: what is fed when, what is confirmed, and what its news stop."""

import asyncio
from collections.abc import Callable
from contextlib import nullcontext
from operator import setitem
from typing import Final

import pytest

from gateway.errors import ConfigError, SpiError
from gateway.model.power_board import SERVO_OVERCURRENT, CanFrame, set_supply
from gateway.robot.core.events import StoppedOutside
from gateway.robot.power.board import Confirmed, News
from gateway.robot.settings import Settings
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Supply, Telemetry
from schemas.words import Kind, Mode, Reason
from tests.support.power import FedElkapod, FedRobot, running
from tests.support.robot import LEG_3, START, all_legs, leg, servo

pytestmark = pytest.mark.virtual_time

LEG_3_SERVOS: Final = frozenset({31, 32, 33})
SERVO_31: Final = 1 << SERVO_IDS.index(31)
UP_S: Final = 1.2
"""The board switches eighteen servos on in three quarters of a second."""


async def ready(**sections: dict[str, object]) -> FedRobot:
    """Return a robot whose board answers, and that feeds nothing."""
    robot = FedRobot(**sections)
    await asyncio.sleep(UP_S)
    assert robot.line.fed() == frozenset()
    return robot


async def runs(**sections: dict[str, object]) -> FedRobot:
    """Return a robot of which leg 3 runs, and is fed."""
    robot = await ready(**sections)
    await starts(robot, within_s=0.4)
    assert robot.line.fed() == LEG_3_SERVOS
    return robot


async def keep(robot: FedRobot | FedElkapod, seconds: float, key: str, payload: dict[str, object]) -> None:
    for _ in range(round(seconds * 10)):
        robot.put(key, payload)
        await asyncio.sleep(0.1)


async def starts(
    robot: FedRobot | FedElkapod, key: str = LEG_3, payload: dict[str, object] = START, *, within_s: float = 0.5
) -> None:
    """Start, and check that the start is accepted once its servos are fed."""
    answers = robot.get(key, payload)
    await asyncio.sleep(within_s)
    assert [ack.accepted for ack in answers] == [True]


def shutdowns(robot: FedElkapod) -> int:
    """Return how many shutdowns the UART has sent."""
    return sum(word == "shutdown" for _, word in robot.said)


async def test_a_servo_is_fed_while_it_runs_or_waits_to_be_started_and_at_no_other_time() -> None:
    robot = await ready()
    answers = robot.get(LEG_3, START)
    assert answers == [], "it waits until its servos are fed"
    assert running(robot) == []
    await asyncio.sleep(0.4)
    assert [ack.accepted for ack in answers] == [True]
    assert running(robot) == sorted(LEG_3_SERVOS)
    assert robot.line.fed() == LEG_3_SERVOS
    report = robot.state().power
    assert report is not None
    assert (report.interface, report.alive, report.supplied, report.confirmed) == ("sim", True, (31, 32, 33), True)
    assert report.age_ms == pytest.approx((robot.now_ns() - (robot.line.status.answered_ns or 0)) / 1e6)
    answers = robot.get(LEG_3, leg("stop"))
    assert robot.line.fed() == frozenset()
    await asyncio.sleep(0.1)
    assert [(ack.accepted, ack.confirmed) for ack in answers] == [(True, True)]
    await starts(robot)
    answers = robot.get(LEG_3, leg("stop", unknown=1))
    await asyncio.sleep(0.1)
    assert [(ack.accepted, ack.confirmed, (ack.confirmed_ms or 0) // 100) for ack in answers] == [(False, True, 0)]


async def test_all_eighteen_start_within_1_4_s_at_once_and_their_watchdog_begins_then() -> None:
    robot = await ready()
    begun_ns = robot.now_ns()
    answers = robot.get(keys.LEGS_COMMAND, all_legs("start", 90))
    for _ in range(140):
        await asyncio.sleep(0 if answers else 0.01)
    assert (robot.now_ns() - begun_ns) / 1e9 < 1.4
    assert running(robot) == list(SERVO_IDS)
    await asyncio.sleep(0.2)
    assert running(robot) == list(SERVO_IDS)
    await asyncio.sleep(0.1)
    assert running(robot) == []
    assert robot.line.fed() == frozenset()


@pytest.mark.lengthy
@pytest.mark.parametrize("how", ["reset", "SPI", "at the start"])
async def test_a_controller_that_hears_nothing_moves_one_servo_of_those_that_are_started(how: str) -> None:
    """It holds all its servos on: whatever is fed, moves."""
    robot = await ready() if how == "at the start" else await runs()
    robot.line.board.draws_ma = [300.0] * len(SERVO_IDS)
    if how == "reset":
        robot.put(keys.ESTOP)
        await asyncio.sleep(0.3)
        robot.put(keys.RESET, {"estop": 1})
    elif how == "SPI":
        robot.controller.fail_where(lambda _: True)
        robot.put(LEG_3, leg("stop"))
        await asyncio.sleep(0.1)
        robot.controller.fail_where(lambda _: False)
    await asyncio.sleep(UP_S)
    assert robot.line.fed() == frozenset(), "nobody started anything"
    answers = robot.get(keys.LEGS_COMMAND, all_legs("start", 90))
    moved: frozenset[int] = frozenset()
    for _ in range(1900):
        await asyncio.sleep(0.001)
        moved |= robot.line.fed()
    assert moved == {11}
    assert [(ack.accepted, ack.reason) for ack in answers] == [(False, Reason.NO_POWER)]
    assert "does not obey" in (answers[0].detail or "")
    assert robot.events(Kind.SERVO_DRAWS)
    assert robot.ask(LEG_3, START).reason is Reason.NO_POWER, "until a reset"
    robot.line.board.draws_ma = [8.0] * len(SERVO_IDS)
    robot.put(keys.RESET, {})
    await asyncio.sleep(0.2)
    await starts(robot)


async def test_an_emergency_stop_takes_all_supply_and_its_answer_waits_for_the_boards() -> None:
    robot = await runs()
    answers = robot.get(keys.ESTOP)
    assert robot.line.fed() == frozenset(), "at once, in the board's interrupt"
    assert answers == []
    await asyncio.sleep(0.15)
    (ack,) = answers
    assert (ack.accepted, ack.confirmed, ack.stop_frames) == (True, True, 6)
    assert ack.confirmed_ms is not None
    assert 26 <= ack.confirmed_ms <= 60
    assert [event.legs for event in robot.events(Kind.POWER_CUT)] == [tuple(LEGS)]
    robot.put(keys.RESET, {"estop": 1})
    await asyncio.sleep(UP_S)
    assert robot.line.fed() == frozenset(), "a start is needed"
    assert robot.state().mode is Mode.IDLE
    assert robot.events(Kind.POWER_RESTORED) == []
    robot.put(LEG_3, START)
    await asyncio.sleep(0.6)
    assert Kind.POWER_RESTORED in [event.kind for event in robot.events()]


async def test_the_end_takes_the_supply() -> None:
    robot = await runs()
    robot.conductor.shut_down()
    assert robot.line.fed() == frozenset()


@pytest.mark.parametrize("whole", [False, True])
async def test_a_bus_at_fault_takes_the_supply(whole: bool) -> None:
    patient: dict[str, object] = {"timeout_ms": 10_000}
    robot = FedElkapod(watchdog=patient) if whole else FedRobot(watchdog=patient)
    await asyncio.sleep(UP_S)
    await starts(robot, keys.LEGS_COMMAND, all_legs("start", 90), within_s=1.4)
    assert robot.line.fed() == set(SERVO_IDS)
    if isinstance(robot, FedElkapod):
        robot.elkapod.spi_fails = True
    else:
        robot.controller.fail_where(lambda _: True)
        robot.put(LEG_3, leg("set", 91, 91, 91))
    await asyncio.sleep(0.021)
    assert robot.line.fed() == frozenset()


async def test_a_step_whose_frames_fail_feeds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await runs()
    asked: list[frozenset[int]] = []
    monkeypatch.setattr(robot.line.ours, "want", lambda servos, *_: asked.append(servos))
    robot.controller.fail_where(lambda _: True)
    robot.put(keys.LEGS_COMMAND, {"legs": {"3": leg("set", 91, 91, 91), "4": START}})
    assert asked
    assert not any(asked)


def _cleared(robot: FedRobot) -> None:
    robot.line.board.temperatures_c[0] = 40
    robot.line.board.clear_by_hand()


TAKEN: Final[dict[str, tuple[Callable[[FedRobot], object], Callable[[FedRobot], object], int]]] = {
    # what takes the supply, what somebody does at the board behind it, and how many faults are published
    "a blocked servo": (lambda robot: robot.line.board.fail(SERVO_OVERCURRENT, SERVO_31), lambda _: None, 1),
    "70 degrees, and its button": (lambda robot: setitem(robot.line.board.temperatures_c, 0, 70), _cleared, 1),
    "another node's mask": (lambda robot: robot.line.hear_from_another(set_supply(0)), lambda _: None, 1),
    # On slcan it shares the terminal, so its masks are never seen, and the board seems silent now and then.
    "stop-servos": (
        lambda robot: robot.conductor._step(StoppedOutside(at_work=True)),
        lambda robot: robot.conductor._step(StoppedOutside(at_work=False)),
        0,
    ),
}


@pytest.mark.lengthy
@pytest.mark.parametrize("what", TAKEN)
async def test_what_takes_the_supply_stops_all_of_the_leg_and_nothing_starts_before_a_reset(what: str) -> None:
    takes, undone, faults = TAKEN[what]
    robot = await runs()
    takes(robot)
    await keep(robot, 0.2, LEG_3, leg("set", 91, 91, 91))
    assert running(robot) == []
    assert robot.line.fed() == frozenset()
    assert len(robot.events(Kind.POWER_FAULT)) == faults
    undone(robot)
    await asyncio.sleep(UP_S)
    assert robot.line.fed() == frozenset(), "nothing comes on by itself"
    ack = robot.ask(LEG_3, START)
    assert (ack.reason, "31" in (ack.detail or "")) == (Reason.NO_POWER, True)
    robot.put(keys.RESET, {})
    await asyncio.sleep(UP_S)
    assert robot.line.fed() == frozenset(), "a start is needed"
    await starts(robot)


THEIRS: Final = 0b111_111_000_000_111_111
"""A mask of another program that we do not receive, as `stop-servos` and others on one slcan adapter."""


@pytest.mark.parametrize("kind", [FedRobot, FedElkapod])
@pytest.mark.parametrize("order", ["mask, estop, reset", "estop, mask, reset", "mask, reset", "mask, fault, reset"])
async def test_a_reset_feeds_no_output_of_another_programs_mask(
    kind: type[FedRobot] | type[FedElkapod], order: str
) -> None:
    robot = kind()
    await asyncio.sleep(UP_S)
    board, fed = robot.line.board, frozenset[int]()
    for what in order.split(", "):
        if what == "mask":
            board.take(set_supply(THEIRS), robot.now_ns())
            board.fail(SERVO_OVERCURRENT, THEIRS)
        elif what == "fault":
            robot.conductor.bus_failed(SpiError("EIO"))
        else:
            robot.put(getattr(keys, what.upper()), {"estop": 1} if "estop" in order and what == "reset" else {})
        for _ in range(1500):
            await asyncio.sleep(0.001)
            fed |= robot.line.fed()
    assert fed == frozenset()
    assert robot.line.status.refused == {}, "the errors are deleted"
    await starts(robot)


@pytest.mark.parametrize("how", ["estop", "off button", "SPI"])
async def test_whatever_takes_all_supply_is_sent_even_if_nothing_should_be_fed(how: str) -> None:
    """Another program's mask may be the board's newest."""
    robot = await ready()
    robot.line.board.take(set_supply(THEIRS), robot.now_ns())
    if how == "estop":
        robot.put(keys.ESTOP)
    elif how == "off button":
        robot.line.board.press_button(robot.now_ns())
    else:
        robot.conductor.bus_failed(SpiError("EIO"))
    for _ in range(1500):
        await asyncio.sleep(0.001)
        assert robot.line.fed() == frozenset()


async def test_what_landed_while_the_board_was_silent_starts_without_a_reset() -> None:
    robot = await runs(watchdog={"landing_ms": 500})
    robot.line.cable = False
    await asyncio.sleep(0.3)
    assert [state.power.alive for state in robot.states[-1:] if state.power] == [False], "published at once"
    robot.line.cable = True
    await asyncio.sleep(UP_S)
    assert running(robot) == []
    await starts(robot)


@pytest.mark.parametrize("late_s", [0.0, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("kind", [FedRobot, FedElkapod])
async def test_after_a_short_silence_a_new_start_is_enough_however_late_the_loop_is(
    kind: type[FedRobot] | type[FedElkapod], late_s: float
) -> None:
    robot = kind(watchdog={"timeout_ms": 10_000})
    await asyncio.sleep(UP_S)
    await starts(robot)
    handle = robot.line.on_news

    def later(news: list[News | Confirmed]) -> None:
        robot.loop.call_later(late_s, handle, news)

    robot.line.on_news = later
    robot.line.cable = False
    for _ in range(200):
        await asyncio.sleep(0.001 * robot.line.ours.alive)
    robot.line.cable = True
    await asyncio.sleep(0.2)
    assert running(robot) == []
    await starts(robot)
    assert "another program" not in str(robot.events())


@pytest.mark.parametrize("how", ["button", "CAN"])
async def test_the_off_button_is_an_emergency_stop(how: str) -> None:
    robot = await runs()
    if how == "button":
        robot.line.board.press_button(robot.now_ns())
    else:
        robot.line.hear_from_another(CanFrame(0x66))
    await asyncio.sleep(0.05)
    state = robot.state()
    assert (state.mode, state.estop, state.estop_source) == (Mode.ESTOPPED, 1, "the power board's off button")
    assert Kind.OFF_BUTTON in [event.kind for event in robot.events()]
    assert robot.line.fed() == frozenset()


# ---- elkapod-2025: a servo's supply is its start and its Stop


async def test_a_stop_of_one_servo_takes_its_supply_at_once_and_is_confirmed() -> None:
    robot = FedElkapod()
    await asyncio.sleep(0.5)
    robot.put(LEG_3, START)
    await keep(robot, 0.4, LEG_3, leg("set", 90, 90, 90))
    assert robot.line.fed() == {31, 32, 33}
    answers = robot.get(keys.servo_command(32), servo("stop"))
    assert robot.line.fed() == {31, 33}
    before = shutdowns(robot)
    await asyncio.sleep(0.1)
    (ack,) = answers
    assert (ack.accepted, ack.confirmed) == (True, True)
    assert shutdowns(robot) == before, "the others run"
    robot.put(LEG_3, leg("stop"))
    assert robot.line.fed() == frozenset()
    assert shutdowns(robot) > before, "with the last, the UART's too"


@pytest.mark.parametrize("kind", [FedRobot, FedElkapod])
async def test_a_stop_beside_moves_takes_its_servos_supply_at_once(kind: type[FedRobot] | type[FedElkapod]) -> None:
    robot = kind(watchdog={"timeout_ms": 10_000})
    await asyncio.sleep(UP_S)
    await starts(robot)
    ops = {"servos": [{"op": "stop"}, *[{"op": "set", "angle_deg": 80}] * 2]}
    answers = robot.get(LEG_3, ops)
    assert robot.line.fed() == {32, 33}
    await asyncio.sleep(0.1)
    assert (running(robot), robot.line.fed(), [ack.accepted for ack in answers]) == (
        [32, 33],
        frozenset({32, 33}),
        [True],
    )


async def test_a_servo_that_its_supply_started_may_draw_current_while_others_wait_for_theirs() -> None:
    robot = FedElkapod()
    robot.line.board.draws_ma = [300.0] * len(SERVO_IDS)
    await asyncio.sleep(0.5)
    for _ in range(2):
        await starts(robot, keys.LEGS_COMMAND, all_legs("start", 90), within_s=1.3)
        robot.put(keys.LEGS_COMMAND, all_legs("stop"))
        await asyncio.sleep(1)
    assert robot.events(Kind.SERVO_DRAWS) == []


async def test_a_switch_that_has_melted_is_found_by_the_current_and_stops_the_whole_elkapod() -> None:
    robot = FedElkapod()
    await asyncio.sleep(0.5)
    robot.put(keys.LEGS_COMMAND, all_legs("start", 90))
    await keep(robot, 1.0, keys.LEGS_COMMAND, all_legs("set", 90))
    robot.line.board.draws_ma = [300.0] * len(SERVO_IDS)
    robot.line.board.stuck = SERVO_31 | SERVO_31 << 1
    robot.put(keys.LEGS_COMMAND, all_legs("stop", legs=[3]))
    await keep(robot, 0.7, keys.leg_command(1), leg("set", 90, 90, 90))
    assert robot.events(Kind.SERVO_DRAWS)
    assert running(robot) == []
    for each in (31, 32):
        assert robot.ask(keys.servo_command(each), servo("start", 90)).reason is Reason.NO_POWER, "until a reset"
    assert robot.said[-1][1] == "shutdown"


async def test_each_stopped_servo_that_draws_is_reported_to_the_core_whatever_else_is_found() -> None:
    supply = (await runs()).conductor.supply
    assert supply is not None
    supply._found = [(11, Kind.SERVO_SILENT, ""), (12, Kind.SERVO_DRAWS, ""), (21, Kind.SERVO_DRAWS, "")]
    seen, announced = supply.take_news(())
    assert [servo_id for servo_id, _ in seen.drew] == [12, 21]
    assert len(announced) == 3


async def test_telemetry_has_what_the_board_measures_of_a_robot_that_measures_nothing_itself() -> None:
    robot = await runs(watchdog={"timeout_ms": 10_000})
    robot.line.board.draws_ma = [100.0] * len(SERVO_IDS)
    await asyncio.sleep(0.505)
    robot.conductor.reports.publish_telemetry()
    (report,) = [each for key, each in robot.reports if key == keys.TELEMETRY and isinstance(each, Telemetry)]
    servos, rails = report.servos or {}, robot.line.status.rails
    assert servos.keys() == set(map(str, SERVO_IDS))
    assert (servos["33"].supplied, servos["63"].supplied) == (True, False)
    assert servos["33"].current_a == pytest.approx(0.1)
    assert report.supply == Supply(voltage_v=rails[0x84][0] / 1000, current_a=rails[0x7E][1] / 1000)
    assert report.converters_v == tuple(mv / 1000 for mv in (*rails[0x80], *rails[0x82]))
    assert len(report.board_temperatures_c or ()) == 3
    assert report.age_ms == pytest.approx((robot.now_ns() - (robot.line.status.answered_ns or 0)) / 1e6)


async def test_a_line_that_listens_no_more_is_noticed_within_thirty_beats() -> None:
    robot = await runs()
    supply = robot.conductor.supply
    assert supply is not None
    for _ in range(40):
        await asyncio.sleep(0.1)
        assert supply.makes_progress()
    robot.line.listens = False
    supply.makes_progress()
    assert [supply.makes_progress() for _ in range(30)] == [True] * 29 + [False]


@pytest.mark.parametrize("kind", [FedRobot, FedElkapod])
async def test_a_board_measures_the_battery_of_a_robot_that_does_not(kind: type[FedRobot] | type[FedElkapod]) -> None:
    robot = kind(watchdog={"timeout_ms": 10_000}, safety={"min_battery_v": 6.5})
    ack = robot.ask(LEG_3, START)
    assert ack.reason in (Reason.BATTERY_LOW, Reason.NO_POWER), "not measured yet"
    await asyncio.sleep(UP_S)
    battery, measured = robot.state().battery, robot.conductor.reports.measured()
    assert battery is not None
    assert measured is not None
    assert measured.battery == battery
    itself = kind is FedElkapod
    assert (battery.voltage_v == 14.8, battery.percent is None) == (not itself, not itself)
    await starts(robot)
    robot.line.board.battery_mv = 6400
    await keep(robot, 0.5, LEG_3, leg("set", 90, 90, 90))
    assert bool(robot.events(Kind.BATTERY_LOW)) is not itself
    assert running(robot) == sorted(LEG_3_SERVOS), "what runs goes on"
    if not itself:
        assert robot.ask(keys.leg_command(4), START).reason is Reason.BATTERY_LOW


@pytest.mark.parametrize(("wire", "power"), [("hexapod-1.0", "socketcan"), ("elkapod-2025", ""), ("hexapod-1.0", "")])
def test_a_limit_for_the_battery_needs_a_board_or_a_wire_that_measures(wire: str, power: str) -> None:
    tables = {"wire": {"name": wire}, "power": {"interface": power}, "safety": {"min_battery_v": 6.5}}
    measured = power or wire == "elkapod-2025"
    with nullcontext() if measured else pytest.raises(ConfigError, match=r"safety\.min_battery_v: .* measures it"):
        Settings.of(tables)
