"""The power board under the service, in virtual time: what is fed when, what is confirmed, and what its news stop."""

import asyncio
from typing import Final

import pytest

from gateway.model.power_board import SERVO_OVERCURRENT, CanFrame, set_supply
from gateway.robot.core.events import StoppedOutside
from gateway.robot.core.power import CutOn
from gateway.robot.runtime.confirmations import MOST_ASKERS
from gateway.robot.service import BEAT_S
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Kind, Mode, Reason, Telemetry
from tests.support.elkapod import all_legs
from tests.support.power import FedElkapod, FedRobot, running
from tests.support.robot import leg, servo

pytestmark = pytest.mark.virtual_time

ALL: Final = frozenset(SERVO_IDS)
LEG_3: Final = keys.leg_command(3)
START: Final = leg("start", 90, 90, 90)
UP_S: Final = 1.0
"""The board switches eighteen servos on in three quarters of a second."""


async def fed(**sections: dict[str, object]) -> FedRobot:
    """A robot whose servos are all fed."""
    robot = FedRobot(**sections)
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL
    return robot


async def keep(robot: FedRobot | FedElkapod, seconds: float, key: str, payload: dict[str, object]) -> None:
    """Send this ten times a second, so that no watchdog expires."""
    for _ in range(round(seconds * 10)):
        robot.put(key, payload)
        await asyncio.sleep(0.1)


async def test_all_servos_are_fed_behind_the_first_stops_and_the_state_says_so() -> None:
    robot = FedRobot()
    assert len(robot.frames) == len(LEGS)
    assert robot.line.fed == frozenset()
    await asyncio.sleep(UP_S)
    report = robot.conductor.state().power
    assert report is not None
    assert (report.interface, report.alive, frozenset(report.supplied), report.confirmed) == ("sim", True, ALL, True)
    answered_ns = robot.line.status.answered_ns
    assert answered_ns is not None
    assert report.age_ms == pytest.approx((robot.now_ns() - answered_ns) / 1e6)


async def test_an_emergency_stop_takes_all_supply_and_its_answer_waits_for_the_boards() -> None:
    robot = await fed()
    answers = robot.get(keys.ESTOP)
    assert robot.line.fed == frozenset(), "at once, in the board's interrupt"
    assert answers == []
    await asyncio.sleep(0.15)
    (ack,) = answers
    assert (ack.accepted, ack.confirmed, ack.stop_frames) == (True, True, 6)
    assert ack.confirmed_ms is not None
    assert 26 <= ack.confirmed_ms <= 60
    assert [event.legs for event in robot.events(Kind.POWER_CUT)] == [tuple(LEGS)]
    robot.put(keys.RESET, {"estop": 1})
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL
    assert robot.conductor.state().mode is Mode.IDLE, "nothing runs"
    assert Kind.POWER_RESTORED in [event.kind for event in robot.events()]


async def test_no_answer_waits_longer_than_confirm_ms_for_a_board_that_says_nothing() -> None:
    robot = await fed(power={"confirm_ms": 100})
    robot.line.unplugged = True
    answers = robot.get(keys.ESTOP)
    await asyncio.sleep(0.099)
    assert answers == []
    await asyncio.sleep(0.003)
    (ack,) = answers
    assert (ack.accepted, ack.confirmed, ack.confirmed_ms) == (True, False, None)
    assert Kind.POWER_UNCONFIRMED in [event.kind for event in robot.events()]


async def test_a_stop_that_leaves_the_supply_on_is_answered_at_once_and_is_believed() -> None:
    robot = await fed()
    assert robot.ask(LEG_3, START).confirmed is None
    ack = robot.ask(LEG_3, leg("stop"))
    assert (ack.accepted, ack.confirmed, ack.confirmed_ms) == (True, False, None)


@pytest.mark.parametrize("cut_on", [[], ["estop"]])
async def test_cut_on_says_what_takes_the_supply(cut_on: list[str]) -> None:
    robot = await fed(power={"cut_on": cut_on})
    robot.put(keys.ESTOP)
    assert robot.line.fed == (frozenset() if cut_on else ALL)


async def test_too_few_buttons_take_the_supply_once_nothing_runs() -> None:
    robot = FedRobot(buttons={"required": 1})
    await asyncio.sleep(UP_S)
    assert robot.line.fed == frozenset(), "nobody watches yet"


@pytest.mark.parametrize("cut_on", [[], ["shutdown"]])
async def test_the_end_takes_the_supply(cut_on: list[str]) -> None:
    robot = await fed(power={"cut_on": cut_on})
    robot.conductor.shut_down()
    assert robot.line.fed == (frozenset() if cut_on else ALL)


async def test_a_bus_that_fails_takes_the_supply_and_one_that_is_back_gives_it_again() -> None:
    robot = await fed()
    robot.put(LEG_3, START)
    robot.controller.fail_where(lambda _: True)
    robot.put(LEG_3, leg("stop"))
    assert robot.conductor.state().mode is Mode.BUS_FAULT
    assert robot.line.fed == frozenset()
    robot.controller.fail_where(lambda _: False)
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL
    assert running(robot) == []


async def test_nothing_starts_while_the_board_is_silent_and_what_runs_is_stopped() -> None:
    robot = await fed()
    robot.put(LEG_3, START)
    await asyncio.sleep(0.05)
    robot.line.unplugged = True
    await asyncio.sleep(0.19)
    assert Kind.POWER_UNCONFIRMED in [event.kind for event in robot.events()]
    assert running(robot) == []
    ack = robot.ask(LEG_3, START)
    assert (ack.accepted, ack.reason) == (False, Reason.NO_POWER)
    answers = robot.get(LEG_3, leg("stop"))
    await asyncio.sleep(0.46)
    assert [(ack.accepted, ack.confirmed) for ack in answers] == [(True, False)]
    robot.line.unplugged = False
    await asyncio.sleep(UP_S)
    assert robot.ask(LEG_3, START).accepted


@pytest.mark.parametrize("by_hand", [True, False])
async def test_a_servo_that_the_board_blocks_is_stopped_and_a_reset_feeds_it_again(by_hand: bool) -> None:
    robot = await fed()
    await keep(robot, 0.2, keys.LEGS_COMMAND, all_legs("start", 90))
    robot.line.simulated.fail(SERVO_OVERCURRENT, outputs=1 << SERVO_IDS.index(31))
    await keep(robot, 0.2, LEG_3, leg("set", 91, 91, 91))
    assert 31 not in running(robot)
    assert 31 not in robot.line.fed
    ack = robot.ask(keys.servo_command(31), servo("start", 90))
    assert (ack.reason, "31" in (ack.detail or "")) == (Reason.NO_POWER, True)
    assert Kind.POWER_FAULT in [event.kind for event in robot.events()]
    if by_hand:
        robot.line.simulated.clear_by_hand()
    await asyncio.sleep(0.5)
    assert 31 not in robot.line.fed, "cleared at the board, it does not come on by itself"
    robot.put(keys.ESTOP)
    await asyncio.sleep(0.2)
    robot.put(keys.RESET, {"estop": 1})
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL
    assert robot.ask(keys.servo_command(31), servo("start", 90)).accepted


async def test_what_another_node_switches_off_counts_as_stopped() -> None:
    robot = await fed()
    robot.put(LEG_3, START)
    await asyncio.sleep(0.05)
    mask = set_supply(0)
    robot.line.hear_from_another(mask)
    await asyncio.sleep(0.02)
    assert running(robot) == []
    assert Kind.POWER_FAULT in [event.kind for event in robot.events()]
    await asyncio.sleep(UP_S)
    assert robot.line.fed == frozenset(), "whoever took it knows why"
    assert robot.ask(LEG_3, START).reason == Reason.NO_POWER
    robot.put(keys.RESET, {})
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL
    assert running(robot) == []
    assert robot.ask(LEG_3, START).accepted


@pytest.mark.parametrize("cut_on", [["shutdown"], []])
async def test_what_stop_servos_takes_is_not_given_back_before_a_reset_though_nothing_of_it_is_seen_on_can(
    cut_on: list[str],
) -> None:
    """On slcan it shares the terminal, so its masks are never seen, and the board seems silent now and then."""
    robot = await fed(power={"cut_on": cut_on})
    robot.put(LEG_3, START)
    robot.conductor._step(StoppedOutside(at_work=True))
    assert robot.line.fed == (frozenset() if cut_on else ALL)
    assert running(robot) == []
    robot.conductor._step(StoppedOutside(at_work=False))
    await asyncio.sleep(UP_S)
    assert robot.line.fed == (frozenset() if cut_on else ALL)
    assert robot.ask(LEG_3, START).reason == (Reason.NO_POWER if cut_on else None)
    robot.put(keys.RESET, {})
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL


async def test_a_board_that_restarts_has_all_off_and_feeds_again_once_it_answers() -> None:
    robot = await fed()
    robot.put(LEG_3, START)
    await keep(robot, 0.1, LEG_3, leg("set", 91, 91, 91))
    robot.line.simulated.restart()
    await keep(robot, 0.2, LEG_3, leg("set", 91, 91, 91))
    assert running(robot) == []
    robot.line.simulated.press_button(robot.line.now_ns())
    await asyncio.sleep(1 + UP_S)
    assert robot.line.fed == ALL
    assert running(robot) == [], "a start is needed"


@pytest.mark.parametrize("how", ["button", "CAN"])
async def test_the_off_button_is_an_emergency_stop(how: str) -> None:
    robot = await fed()
    robot.put(LEG_3, START)
    if how == "button":
        robot.line.simulated.press_button(robot.line.now_ns())
    else:
        robot.line.hear_from_another(CanFrame(0x66))
    await asyncio.sleep(0.05)
    state = robot.conductor.state()
    assert (state.mode, state.estop, state.estop_source) == (Mode.ESTOPPED, 1, "the power board's off button")
    assert Kind.OFF_BUTTON in [event.kind for event in robot.events()]
    assert robot.line.fed == frozenset()


# ---- elkapod-2025: a servo's supply is its start and its Stop


async def test_a_servo_is_fed_once_its_angle_was_in_two_frames_and_the_uart_has_said_start() -> None:
    robot = FedElkapod()
    await asyncio.sleep(0.5)
    assert robot.line.fed == frozenset()
    assert robot.ask(keys.servo_command(31), servo("start", 45)).accepted, "one servo alone"
    await asyncio.sleep(0.2)
    assert robot.line.fed == {31}
    first_ms = next(at_ms for at_ms, frame in robot.line.sent if frame.id == 0x6A and any(frame.data))
    ((start_ms, _),) = [said for said in robot.said if said[1] == "start"]
    assert first_ms >= round(start_ms)


async def test_a_stop_of_one_servo_takes_its_supply_at_once_and_is_confirmed() -> None:
    robot = FedElkapod()
    await asyncio.sleep(0.5)
    robot.put(LEG_3, START)
    await keep(robot, 0.4, LEG_3, leg("set", 90, 90, 90))
    assert robot.line.fed == {31, 32, 33}
    answers = robot.get(keys.servo_command(32), servo("stop"))
    assert robot.line.fed == {31, 33}
    shutdowns = len([said for said in robot.said if said[1] == "shutdown"])
    await asyncio.sleep(0.1)
    (ack,) = answers
    assert (ack.accepted, ack.confirmed) == (True, True)
    assert len([said for said in robot.said if said[1] == "shutdown"]) == shutdowns, "the others run"
    robot.put(LEG_3, leg("stop"))
    assert robot.line.fed == frozenset()
    assert len([said for said in robot.said if said[1] == "shutdown"]) > shutdowns, "with the last, the UART's too"


async def test_a_stop_that_is_not_confirmed_stops_the_whole_robot_over_the_uart() -> None:
    robot = FedElkapod()
    await asyncio.sleep(0.5)
    robot.put(keys.LEGS_COMMAND, all_legs("start", 90))
    await keep(robot, 1.0, keys.LEGS_COMMAND, all_legs("set", 90))
    assert robot.line.fed == ALL
    robot.line.deaf = True  # it answers questions, and does not obey masks
    robot.put(LEG_3, leg("stop"))
    shutdowns = len([said for said in robot.said if said[1] == "shutdown"])
    await keep(robot, 0.6, keys.leg_command(1), leg("set", 90, 90, 90))
    assert len([said for said in robot.said if said[1] == "shutdown"]) > shutdowns
    assert running(robot) == []


# ---- what currents show


@pytest.mark.parametrize("cut_on", [["unconfirmed"], []])
async def test_a_servo_that_draws_after_its_stop_loses_its_supply_until_a_reset(cut_on: list[str]) -> None:
    robot = await fed(power={"cut_on": cut_on, "idle_ma": 100, "settle_ms": 200})
    robot.put(LEG_3, START)
    robot.line.simulated.draws_ma[SERVO_IDS.index(31)] = 101.0
    robot.put(LEG_3, leg("stop"))
    await asyncio.sleep(0.19)
    assert robot.line.fed == ALL, "it may still come to rest"
    await asyncio.sleep(0.4)
    (event,) = robot.events(Kind.SERVO_DRAWS)
    assert (event.legs, "31" in event.detail) == ((3,), True)
    assert robot.line.fed == (ALL - {31} if cut_on else ALL)
    if cut_on:
        assert robot.ask(keys.servo_command(31), servo("start", 90)).reason == Reason.NO_POWER
        robot.line.simulated.draws_ma[SERVO_IDS.index(31)] = 8.0
        robot.put(keys.RESET, {})
        await asyncio.sleep(UP_S)
        assert robot.line.fed == ALL


async def test_a_switch_that_has_melted_is_found_by_the_current_and_stops_the_whole_elkapod() -> None:
    robot = FedElkapod()
    await asyncio.sleep(0.5)
    robot.put(keys.LEGS_COMMAND, all_legs("start", 90))
    await keep(robot, 1.0, keys.LEGS_COMMAND, all_legs("set", 90))
    robot.line.simulated.draws_ma = [300.0] * len(SERVO_IDS)
    robot.line.simulated.stuck = 1 << SERVO_IDS.index(31)
    robot.put(keys.servo_command(31), servo("stop"))
    await keep(robot, 0.7, keys.leg_command(1), leg("set", 90, 90, 90))
    assert robot.events(Kind.SERVO_DRAWS)
    assert running(robot) == []
    assert robot.said[-1][1] == "shutdown"


async def test_a_reset_lets_an_elkapods_servo_start_that_drew_current_after_its_stop() -> None:
    """Nothing of the board changes by it: nothing was fed, and nothing is."""
    robot = FedElkapod()
    await asyncio.sleep(0.5)
    robot.put(keys.servo_command(31), servo("start", 90))
    await keep(robot, 0.5, keys.servo_command(31), servo("set", 90))
    robot.line.simulated.draws_ma = [300.0] * len(SERVO_IDS)
    robot.line.simulated.stuck = 1 << SERVO_IDS.index(31)
    robot.put(keys.servo_command(31), servo("stop"))
    await asyncio.sleep(0.7)
    assert robot.events(Kind.SERVO_DRAWS)
    assert robot.ask(keys.servo_command(31), servo("start", 90)).reason == Reason.NO_POWER
    robot.line.simulated.stuck = 0
    await asyncio.sleep(0.5)
    robot.put(keys.RESET, {})
    await asyncio.sleep(BEAT_S)
    assert robot.ask(keys.servo_command(31), servo("start", 90)).accepted


async def test_a_servo_that_runs_and_draws_nothing_is_reported_once() -> None:
    robot = await fed()
    robot.line.simulated.draws_ma = [8.0] * len(SERVO_IDS)
    robot.line.simulated.draws_ma[SERVO_IDS.index(32)] = 0.0
    robot.put(LEG_3, START)
    await keep(robot, 2.5, LEG_3, leg("set", 90, 90, 90))
    assert ["32" in event.detail for event in robot.events(Kind.SERVO_SILENT)] == [True]


async def test_telemetry_has_what_the_board_measures_of_a_robot_that_measures_nothing_itself() -> None:
    robot = await fed()
    robot.line.simulated.draws_ma = [100.0] * len(SERVO_IDS)
    await asyncio.sleep(0.505)
    robot.conductor.telemetry.publish()
    (report,) = [each for key, each in robot.reports if key == keys.TELEMETRY and isinstance(each, Telemetry)]
    assert report.servos is not None
    assert report.servos.keys() == set(map(str, SERVO_IDS))
    assert report.servos["63"].supplied
    assert report.servos["63"].current_a == pytest.approx(0.1)
    assert report.supply is not None
    rails = robot.line.status.rails
    assert (report.supply.voltage_v * 1000, report.supply.current_a * 1000) == pytest.approx(
        (rails[0x84][0], rails[0x7E][1])
    )
    assert [volts * 1000 for volts in report.converters_v or ()] == pytest.approx([*rails[0x80], *rails[0x82]])
    assert len(report.converters_v or ()) == 5
    assert len(report.board_temperatures_c or ()) == 3
    answered_ns = robot.line.status.answered_ns
    assert answered_ns is not None
    assert report.age_ms == pytest.approx((robot.now_ns() - answered_ns) / 1e6)
    assert report.age_ms > 0


async def test_an_emergency_stop_that_waits_for_the_state_takes_the_supply_before() -> None:
    robot = await fed()
    supply = robot.conductor.supply
    assert supply is not None
    supply.cut_early(CutOn.ESTOP)  # on the thread that has received it, while a transfer holds the state
    assert robot.line.fed == frozenset()
    robot.put(LEG_3, START)  # a step that was decided before
    await asyncio.sleep(0.1)
    assert robot.line.fed == frozenset()
    robot.put(keys.ESTOP)
    await asyncio.sleep(0.2)
    robot.put(keys.RESET, {"estop": 1})
    await asyncio.sleep(UP_S)
    assert robot.line.fed == ALL


async def test_a_line_that_listens_no_more_is_noticed_within_thirty_beats() -> None:
    robot = await fed()
    supply = robot.conductor.supply
    assert supply is not None
    for _ in range(40):
        await asyncio.sleep(0.1)
        assert supply.goes_on()
    robot.line.listens = False
    supply.goes_on()
    assert [supply.goes_on() for _ in range(30)] == [True] * 29 + [False]


async def test_a_robot_that_lands_since_the_board_is_silent_keeps_its_supply_until_it_is_down() -> None:
    robot = await fed(watchdog={"landing_ms": 500, "landing": {"31": 45}})
    robot.put(LEG_3, START)
    robot.line.hears = False
    await keep(robot, 0.4, LEG_3, leg("set", 90, 90, 90))
    assert robot.events(Kind.LANDING)
    assert robot.line.fed == ALL
    await asyncio.sleep(0.5)
    assert running(robot) == []
    assert robot.line.fed == frozenset(), "the board hears us, and we do not hear it"


async def test_who_waits_as_the_gateway_closes_hears_that_nothing_is_confirmed() -> None:
    robot = await fed()
    robot.line.unplugged = True
    answers = [robot.get(keys.ESTOP), robot.get(keys.ESTOP)]
    robot.conductor.close()
    assert [[(ack.accepted, ack.confirmed) for ack in each] for each in answers] == [[(True, False)]] * 2


async def test_stops_that_are_asked_for_at_once_are_each_confirmed() -> None:
    robot = await fed()
    answers = [robot.get(keys.ESTOP) for _ in range(3)]
    await asyncio.sleep(0.15)
    assert [[ack.confirmed for ack in each] for each in answers] == [[True]] * 3


async def test_one_question_serves_a_flood_of_emergency_stops_beside_a_silent_board() -> None:
    """Each waiting answer keeps a query and the buffer that it came in, so few may wait, and all are answered."""
    robot = await fed()
    robot.line.unplugged = True
    supply = robot.conductor.supply
    assert supply is not None
    answers = [robot.get(keys.ESTOP) for _ in range(1000)]
    assert len(robot.line.board._off._waits) == 1
    assert supply.confirmations.waiting == MOST_ASKERS
    assert sum(len(each) for each in answers) == 1000 - MOST_ASKERS, "the others are not confirmed, and know it"
    await asyncio.sleep(0.5)
    assert [[(ack.accepted, ack.confirmed, ack.stop_frames) for ack in each] for each in answers] == [
        [(True, False, 6)]
    ] * 1000
    robot.line.unplugged = False
    await asyncio.sleep(UP_S)
    answers = [robot.get(keys.ESTOP)]
    await asyncio.sleep(0.15)
    assert [[ack.confirmed for ack in each] for each in answers] == [[True]], "nobody of before takes a place"
