"""Watchdog, emergency stop, faults and the end, from a received message to the controller, in virtual time."""

import asyncio
from collections.abc import Callable
from itertools import pairwise
from typing import Final

import pytest

from gateway.errors import SpiError
from gateway.model.frames import Framing, stop_leg
from gateway.robot.core import events
from gateway.robot.core.message import Verb
from gateway.robot.runtime.shutdown import stop_the_robot
from gateway.robot.service import REST_BEAT_S
from schemas import keys
from schemas.robot import LEGS
from schemas.words import Kind, Mode, Reason
from tests.support.controllers import preamble_of
from tests.support.robot import LEG_1, LEG_3, MS, START, Robot, leg, servo, started, started_and_quiet

pytestmark = pytest.mark.virtual_time

ALL_STOPS = [stop_leg(number) for number in LEGS]


async def test_silence_brings_the_stop_at_the_timeout_and_its_repeats_after_it() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, START)
    await asyncio.sleep(0.2)
    robot.put(LEG_3, leg("set", 91, 91, 91))
    await asyncio.sleep(1)
    (last_ms, _), *stops = robot.frames[1:]
    first, repeats = [frame for _, frame in stops[:6]], [frame for _, frame in stops[6:]]
    assert first == [stop_leg(3), *(stop_leg(number) for number in LEGS if number != 3)]
    assert repeats == ALL_STOPS * 3
    assert [at_ms - last_ms for at_ms, _ in stops[::6]] == pytest.approx([250, 270, 290, 310], abs=0.01)
    (event,) = robot.events(Kind.WATCHDOG_EXPIRED)
    assert event.detail == "no command for leg 3 in 250 ms; it is stopped"
    state = robot.state()
    assert state.legs[2].watchdog == "expired"
    assert state.watchdog.expirations == 1
    assert state.watchdog.stop_latency_us.max is not None


async def test_without_a_tick_its_own_thread_serves_it_and_leaves_the_rest() -> None:
    robot = await started_and_quiet()
    waiting = robot.ask_later(LEG_3, START)
    robot.put_later(keys.ESTOP)
    (received,) = [each for each in robot._waiting if each.key == keys.ESTOP]
    robot.estops.append(received)
    robot.conductor.serve_estops()
    assert [frame for _, frame in robot.frames] == ALL_STOPS
    assert waiting == []
    robot.conductor.serve_estops()
    assert len(robot.frames) == 6, "once is enough"


async def test_the_emergency_stop_goes_ahead_of_everything_that_waits_and_latches() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, START)
    await asyncio.sleep(0.001)
    waiting = robot.get(LEG_3, leg("set", 10, 10, 10))
    ack = robot.ask(keys.ESTOP, b"\xff garbage", encoding="image/png", size=10_000)
    assert (ack.accepted, ack.stop_frames, ack.estop) == (True, 6, 1)
    assert ack.latency_us is not None
    assert [frame for _, frame in robot.frames[1:]] == ALL_STOPS
    assert [answer.reason for answer in waiting] == [Reason.ESTOPPED]
    assert robot.ask(LEG_3, START).reason == Reason.ESTOPPED
    assert robot.ask(LEG_3, leg("stop")).reason == Reason.ESTOPPED
    again = robot.ask(keys.ESTOP)
    assert (again.stop_frames, again.estop) == (6, 2), "engaging twice sends the Stops again"
    assert [event.kind for event in robot.events() if event.kind != Kind.COMMAND_REJECTED] == [
        Kind.ESTOP_ENGAGED,
        Kind.LEGS_STOPPED,
    ]
    await asyncio.sleep(0.1)
    assert robot.ask(keys.RESET, {"estop": 2}).accepted
    assert robot.ask(LEG_3, START).accepted


@pytest.mark.parametrize("each_takes_ms", [0, 3])
async def test_an_emergency_stop_and_a_reset_of_one_instant_leave_it_engaged(each_takes_ms: int) -> None:
    robot = await started_and_quiet()
    robot.each_takes_ns = each_takes_ms * MS
    robot.put_later(LEG_1, START)
    robot.put_later(keys.ESTOP)
    robot.put_later(keys.RESET, {"estop": 1})
    robot.conductor.tick()
    assert robot.mode == Mode.ESTOPPED


@pytest.mark.parametrize("ends", [False, True])
async def test_in_a_bus_fault_an_emergency_stop_and_the_end_open_the_device_at_once(ends: bool) -> None:
    robot = await started_and_quiet()
    robot.controller.fail_where(lambda _: True)
    robot.put(LEG_3, START)
    await asyncio.sleep(0.3)
    assert robot.mode == Mode.BUS_FAULT
    robot.controller.fail_where(lambda _: False)
    if ends:
        assert robot.conductor.shut_down()
    else:
        assert robot.ask(keys.ESTOP).stop_frames == 6
    opened = len(robot.openings_ns)
    await asyncio.sleep(0.1)
    assert len(robot.openings_ns) == opened, "and not once more"


async def test_a_deadline_that_passes_in_a_tick_is_of_its_instant(monkeypatch: pytest.MonkeyPatch) -> None:
    """So what the deadline stops is started by nothing that the same tick has taken."""
    robot = await started_and_quiet()
    robot.put(LEG_3, START)
    robot.controller.transfers.clear()
    begun_ms = robot.now_ns() / MS
    robot.each_takes_ns = 130 * MS
    for payload in (START, *[b"{"] * 4):
        robot.put_later(LEG_1, payload)
    instants: list[int | None] = []
    step = robot.conductor.supervisor.step

    def noted(event: events.Event, now_ns: int, instant_ns: int | None = None) -> list[events.Effect]:
        instants.append(instant_ns)
        return step(event, now_ns, instant_ns)

    monkeypatch.setattr(robot.conductor.supervisor, "step", noted)
    robot.conductor.tick()
    assert len(instants) > len(set(instants)) == 1
    late_ms = next(at_ms - begun_ms for at_ms, frame in robot.frames if frame == stop_leg(3))
    assert late_ms == pytest.approx(260, abs=0.1), "between two messages, though none is a command"


@pytest.mark.parametrize("verb", [Verb.PUT, Verb.GET])
async def test_the_keeper_is_called_after_the_stops_of_each_emergency_stop_and_at_its_reset(verb: Verb) -> None:
    robot = Robot()
    told: list[tuple[int, bool, int, str | None]] = []

    def note() -> None:
        latch = robot.conductor.supervisor.latch
        told.append((latch.number, latch.since_ns is not None, len(robot.frames), robot.conductor.reports.estop_source))

    robot.conductor.on_latch = note
    robot.conductor.start()
    await asyncio.sleep(6)
    for source in ("anna", "bert"):
        robot.controller.transfers.clear()
        robot.put(keys.ESTOP, {"source": source}, verb=verb)
    since = robot.state().estop_since
    assert since is not None
    robot.put(keys.RESET, {"estop": 2})
    assert told == [(1, True, 6, "anna"), (2, True, 6, "bert"), (2, False, 6, "bert")]
    assert robot.state().estop_since is None


async def test_a_gateway_needs_beats_while_a_servo_runs_or_a_late_one_would_look_like_a_pause() -> None:
    robot = await started_and_quiet()
    assert robot.conductor.rests(REST_BEAT_S)
    robot.put(keys.leg_command(1), leg("start", 90, 45, 120))
    await asyncio.sleep(0.1)
    assert not robot.conductor.rests(REST_BEAT_S)
    robot.put(keys.leg_command(1), {"servos": [{"op": "stop"}] * 3})
    assert robot.conductor.rests(REST_BEAT_S)
    for max_age_ms, rests in ((0, True), (250, False), (499, False), (500, True)):
        assert (await started_and_quiet(limits={"max_age_ms": max_age_ms})).conductor.rests(REST_BEAT_S) is rests


# ---- messages that were lost in a flood of their key


@pytest.mark.parametrize(
    "left", [[], [leg("set", 1, 1, 1), leg("start", 200, 1, 1)], [leg("start", 1, 1, 1, lease="0" * 32)]]
)
@pytest.mark.parametrize("key", [LEG_3, keys.LEGS_COMMAND, keys.servo_command(32)])
async def test_a_stop_that_may_have_been_lost_counts_as_received(key: str, left: list[object]) -> None:
    robot = await started_and_quiet()
    robot.put(LEG_1, START)
    robot.put(LEG_3, START)
    robot.put_later(key, verb=Verb.LOST)
    for payload in left:
        robot.put_later(key, payload)
    robot.conductor.tick()
    named = {LEG_3: {31, 32, 33}, keys.LEGS_COMMAND: {11, 12, 13, 31, 32, 33}}.get(key, {32})
    assert robot.controller.energised == {11, 12, 13, 31, 32, 33} - named
    (event,) = robot.events(Kind.OVERFLOW)
    assert (event.reason, event.key, event.source) == (Reason.OVERFLOW, key, None)
    assert event.legs == tuple(sorted({servo_id // 10 for servo_id in named}))
    assert "lost on the way to the gateway" in event.detail


async def test_a_start_that_is_newer_than_what_was_lost_keeps_its_servos_running() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, START)
    robot.controller.transfers.clear()
    robot.put_later(LEG_3, verb=Verb.LOST)
    robot.put_later(LEG_3, START)
    robot.put(LEG_3, leg("set", 80, 80, 80))
    assert robot.controller.energised == {31, 32, 33}
    assert not [frame for _, frame in robot.frames if frame.is_stop]
    assert not robot.events(Kind.OVERFLOW)
    robot.put_later(LEG_3, verb=Verb.LOST)
    robot.put(LEG_3, {"servos": [servo("start", 1), servo("set", 1), servo("set", 1)]})
    assert robot.controller.energised == {31}
    robot.put_later(LEG_3, verb=Verb.LOST)
    robot.put_later(LEG_1, START)
    robot.put(LEG_3, START)
    await asyncio.sleep(0.1)
    assert robot.controller.energised == {11, 12, 13, 31, 32, 33}, "also behind another key's"


async def test_an_overflows_stop_is_nobodys_command_and_what_waited_is_rejected_for_it() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_3, leg("start", 90, 90, 90, source="anna"))
    waiting = robot.get(LEG_3, leg("set", 91, 91, 91, source="anna"))
    assert not waiting, "its leg's rate slot has not come"
    accepted = robot.state().commands.accepted
    robot.controller.transfers.clear()
    robot.put(LEG_3, verb=Verb.LOST, size=50)
    assert [frame for _, frame in robot.frames][:1] == [stop_leg(3)]
    assert all(frame.is_stop for _, frame in robot.frames)
    assert [ack.reason for ack in waiting] == [Reason.OVERFLOW]
    assert not robot.events(Kind.SOURCE_CHANGED)
    robot.put(LEG_3, verb=Verb.LOST, size=50)
    assert len(robot.events(Kind.OVERFLOW)) == 1, "nothing ran any more"
    state = robot.state()
    assert state.legs[2].source is None
    assert state.commands.accepted == accepted
    assert (state.commands.overflows, state.commands.lost, state.commands.rejected) == (2, 100, 1)


@pytest.mark.parametrize("verb", [Verb.PUT, Verb.GET])
async def test_a_start_by_another_way_does_not_undo_a_stop_that_may_have_been_lost(verb: Verb) -> None:
    """Nobody knows which of the two is older."""
    robot = await started_and_quiet()
    robot.put(LEG_3, START)
    robot.put_later(LEG_3, verb=Verb.LOST)
    other = keys.servo_command(31) if verb is Verb.PUT else LEG_3
    robot.put(other, servo("start", 1) if verb is Verb.PUT else START, verb=verb)
    await asyncio.sleep(0.1)  # a Start that is taken waits for its leg's rate slot
    assert robot.controller.energised == set()


# ---- faults


@pytest.mark.parametrize(("count", "for_ms"), [(1, 0), (10, 0), (0, 5000)])
async def test_a_failing_bus_is_reopened_with_pauses_and_all_legs_stopped(count: int, for_ms: float) -> None:
    robot = await started_and_quiet()
    for number in LEGS:
        robot.put(keys.leg_command(number), START)
    await asyncio.sleep(0.001)
    waiting = robot.get(LEG_3, leg("set", 10, 10, 10))
    opened_before = len(robot.openings_ns)
    robot.controller.transfers.clear()
    fault_ns = robot.now_ns()
    robot.controller.fail_next(count)
    if for_ms:
        robot.controller.fail_for_ms(for_ms)
    stopped = robot.ask(keys.servo_command(11), {"op": "stop"})
    assert stopped.reason == (Reason.BUS_FAULT if for_ms else None), "a Stop that is written at last is accepted"
    assert [answer.reason for answer in waiting] == [Reason.BUS_FAULT]
    assert robot.mode == Mode.BUS_FAULT
    assert robot.ask(LEG_1, START).reason == Reason.BUS_FAULT
    await asyncio.sleep(12)
    assert robot.mode == Mode.IDLE
    assert [event.kind for event in robot.events() if event.kind != Kind.COMMAND_REJECTED] == [
        Kind.BUS_FAULT,
        Kind.BUS_RECOVERED,
        *[Kind.LEGS_STOPPED] * 2,
    ]
    assert {number for event in robot.events(Kind.LEGS_STOPPED) for number in event.legs} == {*LEGS}
    # Nothing old is sent: the first that the controller hears again is a Stop, and so is everything else.
    assert all(frame.is_stop for _, frame in robot.frames)
    assert [frame for _, frame in robot.frames][-48:-18] == ALL_STOPS * 5, "repeated though nothing else comes"
    assert robot.controller.energised == set()
    openings_ns = robot.openings_ns[opened_before:]
    pauses = [(later - earlier) / MS for earlier, later in pairwise([fault_ns, *openings_ns])]
    expected = [0, *[20] * (len(pauses) - 1)]
    assert pauses == pytest.approx(expected, abs=0.1), "no leg is known to be stopped meanwhile"
    assert robot.ask(LEG_3, leg("set", 1, 1, 1)).reason == Reason.SERVO_STOPPED
    assert robot.ask(LEG_3, START).accepted


async def test_a_bus_that_cannot_be_opened_at_the_start_ends_the_start() -> None:
    robot = Robot()
    robot.controller.fail_next(100)
    with pytest.raises(SpiError):
        robot.conductor.start()


CLAIMS: Final[dict[Kind, Callable[[Robot], object]]] = {
    Kind.WATCHDOG_EXPIRED: lambda _: None,
    Kind.STOPPING: lambda robot: robot.conductor.shut_down(),
    Kind.LEASE_ACQUIRED: lambda robot: robot.lease("take", "bert"),
    Kind.ESTOP_ENGAGED: lambda robot: robot.put(keys.ESTOP),
    Kind.BUTTON_LEFT: lambda robot: robot.button("leave", button=f"{1:032x}"),
}
"""Events that state what the frames of their own step do, and what causes them."""


@pytest.mark.parametrize("kind", CLAIMS)
async def test_an_event_states_that_legs_are_stopped_only_if_the_frames_are_written(kind: Kind) -> None:
    for written in True, False:
        robot = await started_and_quiet(buttons={"required": int(kind is Kind.BUTTON_LEFT)})
        token = robot.button("register", "kitchen").button
        assert robot.button("alive", button=token, count=1).accepted
        robot.put(LEG_3, START)
        if not written:
            robot.controller.fail_for_ms(60_000)
        CLAIMS[kind](robot)
        await asyncio.sleep(0.3)  # longer than the watchdog waits
        (event,) = robot.events(kind)
        stopped = "stopped" in event.detail
        assert (stopped, "could not be written: the simulated" in event.detail) == (written, not written), event.detail


async def test_an_event_about_a_leg_whose_stop_was_written_is_not_changed_by_another_legs_fault() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_1, START)
    robot.put(LEG_3, START)
    robot.controller.fail_where(lambda data: data == stop_leg(3).data)
    await asyncio.sleep(0.3)
    one, three = robot.events(Kind.WATCHDOG_EXPIRED)
    assert one.detail == "no command for leg 1 in 250 ms; it is stopped"
    assert three.detail.startswith("no command for leg 3 in 250 ms; frames for leg 3 could not be written: ")


# ---- the end


async def test_the_end_says_whether_all_six_stops_were_written_and_does_not_wait_for_a_dead_bus() -> None:
    robot = await started_and_quiet()
    assert robot.conductor.shut_down()
    robot = await started_and_quiet()
    robot.controller.fail_next(1)
    assert not robot.conductor.shut_down()
    robot = await started_and_quiet()
    robot.put(LEG_3, START)
    robot.controller.fail_for_ms(60_000)
    robot.put(LEG_3, leg("stop"))
    assert not robot.conductor.shut_down()
    await asyncio.wait_for(robot.conductor.done.wait(), 0.001)
    assert robot.mode == Mode.STOPPING


async def test_in_a_published_controllers_framing_the_preamble_comes_first_and_after_each_fault() -> None:
    robot = started(spi={"framing": "length-prefixed"})
    first = [data for _, data in robot.controller.transfers][:18]
    assert first == [*preamble_of(Framing.LENGTH_PREFIXED), b"\x0e", stop_leg(1).data]
    await asyncio.sleep(1)
    robot.put(LEG_3, START)
    assert robot.controller.energised == {31, 32, 33}
    robot.controller.transfers.clear()
    robot.controller.fail_next(1)
    robot.put(LEG_3, leg("set", 91, 91, 91))
    await asyncio.sleep(0.1)
    assert [data for _, data in robot.controller.transfers][:18] == first
    assert robot.controller.energised == set()
    assert robot.controller.corruptions.total() == 0


@pytest.mark.parametrize("number", [2, None])
async def test_the_black_box_states_which_last_stops_were_not_written(
    number: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, ended = await started_and_quiet(), list[str]()
    robot.controller.fail_where(lambda data: number is None or data == stop_leg(number).data)
    monkeypatch.setattr(robot.conductor.recorder, "ended", ended.append)
    assert not await stop_the_robot(robot.conductor)
    assert f"no Stop could be written to legs {number or '1, 2, 3, 4, 5, 6'}: the simulated" in ended[0]
