"""Commands from a received message to frames, answers and reports, in virtual time; and what a fault rejects."""

import asyncio
import logging
import random
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import groupby, permutations
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.errors import SpiError
from gateway.model.black_box import RING_FILE
from gateway.model.frames import PREAMBLE_ZEROS, ZERO, Framing, OneLeg, Op, ServoOp, stop_leg
from gateway.people.incidents import ring_reader as rec
from gateway.robot.core import events
from gateway.robot.core.events import NOBODY, TimePassed, Transmit
from gateway.robot.core.message import Verb
from gateway.robot.runtime.executor import Outcome
from gateway.robot.spi import Sent
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Cause, Kind, Mode, Reason
from tests.support.controllers import on_wire
from tests.support.power import FedRobot
from tests.support.robot import LEG_1, LEG_3, MS, START, Robot, elkapod, leg, servo, started_and_quiet
from tests.unit.people.test_recorder import contents, recorded

pytestmark = pytest.mark.virtual_time


@pytest.mark.parametrize("key", ["hexapod/leg/{}/cmd", "hexapod/" + "x" * 86 + "{}/cmd"])
async def test_a_rejection_repeats_no_token_that_stands_in_a_key(key: str) -> None:
    robot = Robot()
    token = "0123456789abcdef" * 2
    ack = robot.ask(key.format(token), {})
    robot.conductor.executor.reject_unread(key.format(token), NOBODY, "nothing reads this key")
    rejections = robot.events(Kind.COMMAND_REJECTED)
    assert len(rejections) == 2
    assert not any(token in report.model_dump_json() for report in (ack, *rejections))


# ---- What the conductor learns besides commands: of the power board, of the controller, of others on the device


ALL_STOPS = [stop_leg(number) for number in LEGS]


def kinds(robot: Robot) -> list[Kind | str]:
    return [event.kind for event in robot.events() if event.kind is not Kind.COMMAND_REJECTED]


async def test_what_comes_after_the_end_changes_nothing() -> None:
    robot = FedRobot()
    await asyncio.sleep(1)
    waiting = robot.get(keys.ESTOP)
    robot.conductor.bus_failed(SpiError("unplugged"))
    robot.conductor.close()
    assert [ack.confirmed for ack in waiting] == [False], "what waits for the power board is answered"
    robot.reports.clear()
    robot.controller.transfers.clear()
    robot.conductor.power_changed([])
    robot.conductor.bus_failed(SpiError("timed out"))
    answers: list[bytes] = []
    robot.leases.read(b'{"do": "acquire", "source": "anna"}', 0, answers.append)()
    robot.buttons.read(b'{"do": "register", "source": "kitchen"}', 0, answers.append)()
    await asyncio.sleep(1)
    assert (robot.reports, robot.frames, answers, robot.mode) == ([], [], [], Mode.BUS_FAULT), "no device is opened"


async def test_a_controller_is_found_silent_though_a_transfer_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = await elkapod()
    monkeypatch.setattr(robot, "_go_on", lambda: None)
    hangs_ns = robot.now_ns()
    while not robot.events(Kind.CONTROLLER_SILENT):
        await asyncio.sleep(0.1)  # as the beat does
        assert not robot.said
        robot.conductor.check_outside()
    assert (robot.now_ns() - hangs_ns) / 1e9 < 0.5
    assert [what for _, what in robot.said] == ["shutdown"]


async def test_stop_servos_that_began_during_a_bus_fault_is_found_before_a_command_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = await started_and_quiet()
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    for expected in ([Kind.BUS_FAULT, Kind.STOPPED_OUTSIDE, Kind.BUS_RECOVERED], [Kind.BUS_FAULT, Kind.BUS_RECOVERED]):
        robot.reports.clear()
        robot.conductor.bus_failed(SpiError("unplugged"))
        robot.conductor.check_outside()  # a closed device shows neither its begin nor its end
        assert kinds(robot) == [Kind.BUS_FAULT]
        await asyncio.sleep(0.01)
        assert robot.mode == Mode.IDLE
        assert robot.ask(LEG_3, START).reason is Reason.SERVO_STOPPED
        assert kinds(robot) == expected, "known before the bus is open"


async def test_stop_servos_is_found_at_the_start_and_its_stops_are_repeated_though_nothing_else_happens(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = Robot()
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    robot.conductor.start()
    assert robot.ask(LEG_3, START).reason is Reason.SERVO_STOPPED
    robot = await started_and_quiet(rules={"repeats": 2})
    monkeypatch.setattr(robot.controller, "stop_servos_at_work", lambda: True)
    robot.conductor.check_outside()
    await asyncio.sleep(0.2)
    assert [frame for _, frame in robot.frames] == ALL_STOPS * 3


async def test_the_black_box_has_each_command_that_stops_with_its_sender_and_time(folder: Path) -> None:
    robot = recorded(folder)
    robot.put(LEG_3, START)
    robot.put(LEG_3, verb=Verb.LOST)
    received_ns = robot.now_ns()
    robot.sleep_through(0.1)
    robot.put_later(LEG_3, leg("stop", source="bert", unknown=1), verb=Verb.GET, source="bert", received_ns=received_ns)
    robot.put_later(keys.ESTOP, {"source": "anna"}, verb=Verb.DELETE, received_ns=received_ns + 1)
    robot.conductor.tick()
    records = rec.read(folder / RING_FILE)
    found = [(each.ns, *each.content[:4]) for each in records if isinstance(each.content, rec.CommandRecord)]
    assert found[1:] == [
        (received_ns, 3, Verb.GET, LEG_3, "bert"),
        (received_ns + 1, 0, Verb.DELETE, keys.ESTOP, "anna"),
    ]
    ended = [each for content in contents(folder, rec.CommandRecord, rec.StepRecord) for each in content.ended]
    assert ended == [(1, "accepted"), (2, "accepted"), (3, Reason.INVALID)]


# ---- Another program changed the device's settings: what is published, what is stopped, and which Stops still leave


CYCLE = [Kind.BUS_MEDDLED, Kind.BUS_FAULT, Kind.BUS_RECOVERED, Kind.LEGS_STOPPED]


async def meddled(monkeypatch: pytest.MonkeyPatch) -> tuple[Robot, list[str]]:
    """Return a robot of which leg 3 runs, which has not written for a while, and whose device was changed."""
    robot = await started_and_quiet(watchdog={"timeout_ms": 10_000}, rules={"repeats": 2})
    assert robot.ask(LEG_3, START).accepted
    await asyncio.sleep(0.5)
    robot.controller.transfers.clear()
    robot.reports.clear()
    found = ["mode 3"]
    monkeypatch.setattr(robot.controller, "put_right", lambda: found.pop() if found else None)
    return robot, found


@pytest.mark.parametrize("command", [None, START, leg("stop")], ids=["the check", "a start", "a Stop"])
async def test_what_finds_it_publishes_it_and_stops_all_legs(monkeypatch: pytest.MonkeyPatch, command: object) -> None:
    robot, _ = await meddled(monkeypatch)
    robot.conductor.check_outside() if command is None else robot.put(LEG_1, command)
    assert [state.mode for state in robot.states] == [Mode.BUS_FAULT], "at once"
    await asyncio.sleep(0.001)
    assert [frame for _, frame in robot.frames][-6:] == ALL_STOPS
    assert robot.controller.energised == set()
    assert kinds(robot) == CYCLE
    assert [event.detail for event in robot.events(Kind.BUS_MEDDLED)] == ["mode 3"]
    assert robot.ask(LEG_3, leg("set", 91, 91, 91)).reason is Reason.SERVO_STOPPED
    for _ in range(3):
        robot.conductor.check_outside()
    assert robot.ask(LEG_3, START).accepted
    assert kinds(robot) == CYCLE


async def test_a_start_that_finds_it_publishes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    await asyncio.sleep(1)  # after a pause, as at each start
    robot = Robot()
    monkeypatch.setattr(robot.controller, "put_right", lambda: "mode 3")
    robot.conductor.start()
    assert kinds(robot) == CYCLE[:2]


async def test_at_the_end_the_stops_and_their_repeats_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, found = await meddled(monkeypatch)
    assert robot.conductor.shut_down()
    assert not robot.conductor.done.is_set(), "the repeats are still to come"
    found.append("mode 1")
    robot.conductor.check_outside()
    await asyncio.sleep(1)
    assert [frame for _, frame in robot.frames] == ALL_STOPS * 3
    assert robot.conductor.done.is_set()
    assert [event.detail for event in robot.events(Kind.BUS_MEDDLED)] == ["mode 3", "mode 1"]
    assert not robot.events(Kind.BUS_FAULT)
    robot.conductor.close()
    assert robot.bus.stop_servos_at_work() is None, "a closed device shows nothing"


async def test_the_first_stops_leave_at_once_and_each_repeat_finds_its_preamble_written() -> None:
    """The preamble of a published controller leaves in the pauses of a stream."""
    spi = {"framing": "length-prefixed", "frame_gap_us": 20}
    robot = await started_and_quiet(spi=spi, rules={"repeats": 3})
    await asyncio.sleep(1)  # long enough for the bus to count as synchronised by its rest
    robot.put(keys.LEGS_COMMAND, {"legs": {str(number): START for number in LEGS}})
    await asyncio.sleep(0.05)
    robot.controller.transfers.clear()
    begun_ns = robot.now_ns()
    assert robot.ask(keys.ESTOP).stop_frames == 6
    assert [data for _, data in robot.controller.transfers] == on_wire(Framing.LENGTH_PREFIXED, *ALL_STOPS)
    await asyncio.sleep(1)
    runs = [
        (zeros, [(at_ns - begun_ns) / MS for at_ns, _ in run])
        for zeros, run in groupby(robot.controller.transfers, lambda each: each[1] == ZERO)
    ]
    assert [(zeros, len(at_ms)) for zeros, at_ms in runs] == [(False, 12), *[(True, 16), (False, 12)] * 3]
    assert [at_ms[0] for _, at_ms in runs[::2]] == pytest.approx([0, 20, 40, 60], abs=0.01)
    for (_, zeros_ms), (_, repeat_ms) in zip(runs[1::2], runs[2::2], strict=True):
        assert 2 < repeat_ms[0] - zeros_ms[-1] <= repeat_ms[0] - zeros_ms[0] < 6, "in the pause, and none too early"
    robot.controller.transfers.clear()
    robot.ask(keys.ESTOP)
    for seconds in (0.018, 0.012):  # the loop is held from when the preamble is due until the repeats are
        robot.sleep_through(seconds)
        robot.conductor.tick()
    await asyncio.sleep(0.001)
    assert [data for _, data in robot.controller.transfers][12:-12] == [ZERO] * PREAMBLE_ZEROS


# ---- what is counted, and a device that fails


async def test_an_emergency_stop_says_how_long_it_took_and_is_measured() -> None:
    robot = await started_and_quiet()
    ack = robot.ask(keys.ESTOP, received_ns=robot.now_ns() - 3 * MS)
    assert ack.stop_frames == 6
    assert ack.latency_us == pytest.approx(3000, abs=1)
    assert list(robot.conductor.metrics.emergency_stops.recent_us) == [ack.latency_us]
    robot.controller.fail_next(1)
    assert robot.ask(keys.ESTOP).stop_frames == 6, "those that failed were tried again at once"
    robot.controller.fail_next(1000)
    assert robot.ask(keys.ESTOP).stop_frames == 0
    assert len(robot.conductor.metrics.emergency_stops.recent_us) == 2, "that was none for all legs"
    assert robot.ask(keys.ESTOP, received_ns=robot.now_ns() + MS).latency_us == 0, "none is negative"


async def test_frames_are_counted_by_their_cause_and_commands_by_what_became_of_them() -> None:
    robot = await started_and_quiet()
    metrics = robot.conductor.metrics
    before = dict(metrics.frames)
    robot.put(LEG_3, START)
    for _ in range(3):
        robot.put(LEG_3, leg("set", 80, 80, 80))
    robot.put(LEG_1, leg("set", 80, 80, 80))
    await asyncio.sleep(0.1)
    assert metrics.frames[Cause.COMMAND] - before.get(Cause.COMMAND, 0) == 2
    assert (metrics.accepted, metrics.coalesced) == (4, 2)
    assert metrics.rejected[Reason.SERVO_STOPPED] == 1


async def test_after_a_stop_that_failed_nothing_of_its_command_moves() -> None:
    robot = await started_and_quiet()
    robot.put(LEG_1, START)
    robot.controller.fail_next(1)
    both = {"legs": {"1": leg("stop"), "2": START}}
    assert robot.ask(keys.LEGS_COMMAND, both).reason == Reason.BUS_FAULT
    assert not robot.controller.energised & {21, 22, 23}


async def test_stops_leave_before_repeated_ones_and_these_before_what_moves() -> None:
    robot = await started_and_quiet()
    move = OneLeg(2, (ServoOp(Op.START, 90_00),) * 3)
    effects = [Transmit(stop_leg(1), Cause.COMMAND), Transmit(stop_leg(3), Cause.REPEAT), Transmit(move, Cause.COMMAND)]
    for order in permutations(effects):
        written = robot.conductor.executor.carry_out(order, (TimePassed(), 0, 0)).written
        assert [transmit for transmit, _ in written] == effects


async def test_the_log_says_nothing_twice_and_names_legs_as_a_person_does(caplog: pytest.LogCaptureFixture) -> None:
    robot = await started_and_quiet()
    with caplog.at_level(logging.INFO):
        assert robot.ask(LEG_3, START).accepted
        await asyncio.sleep(1)
    lines = [(each.message, getattr(each, "mode", None), getattr(each, "legs", None)) for each in caplog.records]
    silent = "no command for leg 3 in 250 ms; it is stopped"
    assert lines == [("mode active", None, None), (silent, None, "3"), ("mode idle", None, None)]


async def test_a_device_that_takes_no_lists_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    robot = await started_and_quiet()
    robot.take_no_lists()
    for _ in range(2):
        assert robot.ask(keys.ESTOP).stop_frames == 6
    assert caplog.messages.count("no lists; from now on, each transfer is a separate call") == 1


# ---- The usual way of a setpoint does what the general way does


def _newest(found: list[str]) -> str | None:
    return found.pop() if found else None


class General(Robot):
    """A robot whose setpoints all go the general way."""

    def _beat(self) -> None:
        self.conductor.supervisor._has_usual = False
        super()._beat()


@pytest.mark.parametrize("framing", list(Framing))
@pytest.mark.parametrize("frames", [True, False])
@pytest.mark.parametrize("seed", range(2))
async def test_a_setpoint_is_carried_out_alike_in_the_usual_and_in_the_general_way(
    framing: Framing, frames: bool, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Transfers, records, reports, answers and counters are equal, with failed calls and other programs' settings."""
    sections: dict[str, dict[str, Any]] = {
        "spi": {"framing": framing},
        "telemetry": {"frames": frames},
        "watchdog": {"timeout_ms": 2000},
    }
    robots = [make({**sections, "state": {"path": str(tmp_path / make.__name__)}}) for make in (Robot, General)]
    found: list[list[str]] = [[], []]
    for robot, meddling in zip(robots, found, strict=True):
        (tmp_path / type(robot).__name__).mkdir()
        monkeypatch.setattr(robot.controller, "put_right", partial(_newest, meddling))
        robot.conductor.start()
        robot.conductor.recorder.open(nullcontext())
    await asyncio.sleep(2)
    answers: tuple[list[bytes], list[bytes]] = ([], [])
    chance, usual = random.Random(seed), 0  # noqa: S311  (order, no secrets)
    for turn in range(200):
        await asyncio.sleep(chance.choice((0.005, 0.02, 0.02, 0.2)))
        what, angle_deg = chance.random(), 40 + chance.randrange(8000) / 100
        names = {"source": "anna"} if chance.random() < 0.98 else {}
        setpoint = leg("start" if what < 0.3 else "set", *[angle_deg] * 3)
        if what > 0.98:
            setpoint = leg("stop")
        number = chance.randint(0, 6)
        key = keys.leg_command(number) if number else keys.LEGS_COMMAND
        payload = {**(setpoint if number else {"legs": {str(each): setpoint for each in LEGS}}), **names}
        fault, acknowledged = chance.random(), chance.random() < 0.2
        for robot, meddling, answered in zip(robots, found, answers, strict=True):
            if fault < 0.02:
                robot.controller.fail_next(1)
            elif fault < 0.03:
                meddling.append("mode 3")
            elif turn == 100:
                robot.take_no_lists()
            usual += robot.now_ns() < robot.conductor.supervisor.usual_ns
            robot._instants += 1
            if acknowledged:
                robot.ask_later(key, payload)
                robot._waiting[-1] = replace(robot._waiting[-1], reply=answered.append)
            else:
                robot.put_later(key, payload)
            robot.conductor.tick()
    assert robots[0].controller.transfers == robots[1].controller.transfers
    assert robots[0].conductor.metrics == robots[1].conductor.metrics
    assert usual > 50, "most setpoints went the usual way"
    assert answers[0] == answers[1] != []
    reports = [[(key, each.model_dump(exclude={"time"})) for key, each in robot.reports] for robot in robots]
    assert reports[0] == reports[1]
    for robot in robots:
        robot.conductor.recorder.close()
    records = [
        [
            (each.ns, each.content)
            for each in rec.read(tmp_path / make.__name__ / RING_FILE)
            if not isinstance(each.content, rec.Keyframe)
        ]
        for make in (Robot, General)
    ]
    assert records[0] == records[1]


async def test_stops_count_that_have_the_cause_and_were_received() -> None:
    sent = [Sent(0, 1, 0, 0, received=received) for received in (True, False, True)]
    causes = (Cause.ESTOP, Cause.ESTOP, Cause.REPEAT)
    frames = [events.Transmit(stop_leg(1), cause) for cause in causes]
    assert Outcome(written=list(zip(frames, sent, strict=True))).stop_frames(Cause.ESTOP) == 1


async def test_a_reset_whose_step_cannot_write_repeated_stops_is_accepted() -> None:
    robot = await started_and_quiet()
    robot.put(keys.ESTOP)
    robot.sleep_through(0.03)  # the next step writes repeated Stops, which fail
    robot.controller.fail_where(lambda _: True)
    accepted = robot.conductor.metrics.accepted
    ack = robot.ask(keys.RESET, {"estop": 1})
    assert (ack.accepted, robot.mode) == (True, Mode.BUS_FAULT)
    assert robot.conductor.metrics.accepted == accepted + 1
    assert len(robot.events(Kind.ESTOP_RESET)) == 1
    assert not robot.events(Kind.COMMAND_REJECTED)
    robot.controller.fail_where(lambda _: False)
    await asyncio.sleep(0.1)
    assert robot.mode == Mode.IDLE, "as its answer says"


async def test_a_stop_that_was_written_is_accepted_though_another_commands_frame_fails() -> None:
    """Leg 1's start leaves in the same step, behind the Stop of leg 3."""
    robot = await started_and_quiet(limits={"leg_rate_hz": 10})
    robot.put(LEG_1, START)
    answers = robot.get(LEG_1, leg("set", 45, 45, 45))
    robot.sleep_through(0.2)
    robot.controller.fail_where(lambda data: data != stop_leg(3).data)
    stopped = robot.ask(LEG_3, leg("stop"))
    assert (stopped.accepted, robot.mode) == (True, Mode.BUS_FAULT)
    assert [(ack.accepted, ack.reason) for ack in answers] == [(False, Reason.BUS_FAULT)]
    assert str(answers[0].detail).startswith("the frame could not be written: ")


async def test_a_rejected_command_does_not_claim_stops_that_were_not_written() -> None:
    robot = await started_and_quiet()
    robot.controller.fail_where(lambda _: True)
    ack = robot.ask(LEG_3, {"servos": [servo("stop"), servo("set", 80), servo("set", 80)]})
    assert (ack.reason, ack.stopped) == (Reason.SERVO_STOPPED, None)


# ---- A command of several frames that fails after some were written is answered as what it is, with these legs named


STAGGER_MS = 200

CAUSES: Final[dict[str, tuple[Callable[[Robot], object], Reason, list[int]]]] = {
    # what ends the command, why its rest is rejected, and which legs run on
    "a Stop of a leg that waits": (
        lambda robot: robot.put(keys.leg_command(6), leg("stop")),
        Reason.SERVO_STOPPED,
        [1, 2],
    ),
    "a Stop of a leg that runs": (lambda robot: robot.put(keys.leg_command(2), leg("stop")), Reason.SERVO_STOPPED, [1]),
    "another holder of the lease": (lambda robot: robot.lease("acquire", "bert"), Reason.NOT_HOLDER, [1, 2]),
    "stop-servos": (
        lambda robot: robot.conductor._step(events.StoppedOutside(at_work=True)),
        Reason.SERVO_STOPPED,
        [],
    ),
    "an emergency stop": (lambda robot: robot.put(keys.ESTOP), Reason.ESTOPPED, []),
    "the end": (lambda robot: robot.conductor.shut_down(), Reason.STOPPING, []),
}


@pytest.mark.parametrize(("cause", "reason", "run_on"), CAUSES.values(), ids=CAUSES)
async def test_the_rest_is_withdrawn_and_the_answer_names_what_was_written(
    cause: Callable[[Robot], object], reason: Reason, run_on: list[int]
) -> None:
    robot = await started_and_quiet(
        limits={"start_stagger_ms": STAGGER_MS}, watchdog={"timeout_ms": 5000}, rules={"repeats": 0}
    )
    answers = robot.get(keys.LEGS_COMMAND, {"legs": {str(number): leg("start", 90, 90, 90) for number in LEGS}})
    await asyncio.sleep(0.25)
    assert answers == [], "legs 1 and 2 are started, and no others"
    cause(robot)
    (ack,) = answers
    assert (ack.accepted, ack.reason, ack.written) == (False, reason, [1, 2])
    assert ack.detail is not None
    assert ack.detail.endswith("; the command's frames for legs 1 and 2 were already written")
    await asyncio.sleep(2 * len(LEGS) * STAGGER_MS / 1000)
    assert robot.controller.energised == {servo_id for servo_id in SERVO_IDS if servo_id // 10 in run_on}
    (rejected,) = robot.events(Kind.COMMAND_REJECTED)
    assert rejected.detail == ack.detail
