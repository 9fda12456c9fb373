"""A robot and its power board in any order of commands, faults and restarts, with a second node and a second board.

Judged at each output that the board switches on: only what was started and waits for it is fed; `elkapod-2025` feeds
behind two frames with its angle. Judged at each frame: no start leaves before its servo is fed. Judged at each answer:
what is confirmed to be off is off.
"""

import asyncio
from collections.abc import Callable, Collection
from typing import Any, Final

import async_solipsism
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.model.elkapod import START
from gateway.model.power_board import ALL, ASK_RAILS, SERVO_OVERCURRENT, CanFrame, set_supply
from gateway.robot.core.message import Verb
from gateway.simulation.board import SimulatedBoard
from schemas import keys
from schemas.ack import Ack
from schemas.robot import LEGS, SERVO_IDS
from tests.support.power import FedElkapod, FedRobot
from tests.support.robot import all_legs, angles_of, leg, servo

pytestmark = pytest.mark.full

LINK_NS: Final = 1_100_000_000
"""So long behind a fault of the link a board may still carry out an old mask, one output after the other."""
SEEN_NS: Final = 1_000_000_000
"""A second board is noticed earlier."""
STEPS: Final = st.lists(
    st.tuples(
        st.sampled_from(
            [
                *("start leg", "start servo", "stop leg", "stop servo", "start all", "set all", "start all", "set all"),
                *("estop", "reset", "estop and reset", "cut early", "reset"),
                *("unplug", "plug", "deaf", "obeys", "mute", "speaks"),
                *("restart", "press", "block", "by hand", "another all", "another none", "another some"),
                *("unseen none", "unseen blocked"),
                *("SPI fails", "SPI works"),
                *("another asks", "second board", "real board goes", "one board again", "ask stop", "ask estop"),
            ]
        ),
        st.sampled_from(LEGS),
        st.sampled_from([0.0, 0.0005, 0.005, 0.02, 0.03, 0.045, 0.06, 0.11, 0.17, 0.4, 0.9]),
    ),
    max_size=30,
)
AnyRobot = FedRobot | FedElkapod


class Judged(SimulatedBoard):
    """A board that tells of each output that goes on or off."""

    def __init__(self, changed: Callable[[int, int], None]) -> None:
        super().__init__()
        self._changed = changed

    def take(self, frame: CanFrame, now_ns: int) -> list[CanFrame]:
        before = self.fed
        answers = super().take(frame, now_ns)
        self._changed(before, self.fed)
        return answers

    def advance(self, now_ns: int) -> list[CanFrame]:
        before = self.fed
        answers = super().advance(now_ns)
        self._changed(before, self.fed)
        return answers

    def restart(self) -> None:
        before = self.fed
        super().restart()
        self._changed(before, self.fed)


class Judge:
    """Each servo's last command, and when it lost its supply."""

    def __init__(self, robot: AnyRobot) -> None:
        self.robot = robot
        self.started_ns = dict.fromkeys(SERVO_IDS, -1)
        self.lost_ns = dict.fromkeys(SERVO_IDS, -1)
        self.angles: dict[int, set[float]] = {servo_id: set() for servo_id in SERVO_IDS}
        """Since its start."""
        self.faulty_ns = -LINK_NS
        self.foreign = 0
        """Outputs that another node's mask may switch on: one that we did not receive, until we send ours."""
        self.real = robot.line.board = Judged(self.changed)
        self.second_ns: int | None = None
        """Since when a second board is on the bus."""

    def waits(self, servo_id: int) -> bool:
        servo = self.robot.conductor.supervisor.legs.servos[servo_id]
        return servo.will_run and not servo.running

    def runs(self, servo_id: int) -> bool:
        return self.robot.conductor.supervisor.legs.servos[servo_id].will_run

    def started(self, servo_ids: list[int], angle_deg: float) -> None:
        for servo_id in servo_ids:
            runs = self.started_ns[servo_id] > self.lost_ns[servo_id] and self.runs(servo_id)
            self.started_ns[servo_id] = self.robot.now_ns()
            self.angles[servo_id] = {angle_deg, *(self.angles[servo_id] if runs else ())}

    def changed(self, before: int, after: int) -> None:
        now_ns = self.robot.now_ns()
        line = self.robot.line
        if not line.cable or line.deaf or not line.hears:
            self.faulty_ns = now_ns
        for place, servo_id in enumerate(SERVO_IDS):
            bit = 1 << place
            if before & ~after & bit:
                self.lost_ns[servo_id] = now_ns
            if after & ~before & ~self.foreign & bit and now_ns - self.faulty_ns > LINK_NS:
                self.came_on(servo_id)

    def came_on(self, servo_id: int) -> None:
        robot = self.robot
        assert self.waits(servo_id), f"nobody started {servo_id}, or it runs on where it lost its supply"
        if isinstance(robot, FedElkapod):
            for _, frame in list(robot.elkapod.transfers)[-2:]:
                assert angles_of(frame)[servo_id] in self.angles[servo_id], f"{servo_id} is fed before its angle"
            assert robot.elkapod.messages[-1][1] == START

    def off_is_off(self, key: str, payload: object, servo_ids: Collection[int]) -> None:
        """Ask for a Stop. If the answer is confirmed, the real board must feed none of these."""
        robot = self.robot

        def answered(data: bytes) -> None:
            ack = Ack.model_validate_json(data)
            wanted = {servo_id for servo_id in servo_ids if self.runs(servo_id)}  # started again since
            fed = self.real_fed() & set(servo_ids) - wanted
            assert not (ack.confirmed and fed), f"{fed} are confirmed off, and fed"

        robot.put_later(key, payload, verb=Verb.GET, reply=answered)
        robot.conductor.tick()

    def real_fed(self) -> set[int]:
        return {servo_id for place, servo_id in enumerate(SERVO_IDS) if self.real.fed >> place & 1}

    def nothing_stopped_is_fed(self) -> None:
        """Check right after a Stop, on a line that works."""
        line = self.robot.line
        if line.board is self.real and line.cable and not line.deaf:
            ours = {servo_id for place, servo_id in enumerate(SERVO_IDS) if not self.foreign >> place & 1}
            fed = [servo_id for servo_id in line.fed() & ours if not self.runs(servo_id)]
            assert not fed or self.robot.now_ns() - self.faulty_ns < LINK_NS, f"{fed} are stopped and fed"


def do(judge: Judge, what: str, number: int) -> None:
    """Do one step."""
    robot = judge.robot
    if what.split(maxsplit=1)[0] in ("start", "set", "stop"):
        command(judge, what, number)
    elif what == "reset":
        (ack,) = robot.get(keys.RESET, {"estop": robot.state().estop})
        judge.foreign = 0 if ack.accepted else judge.foreign
    elif what in ("estop", "estop and reset", "cut early"):
        if what == "cut early":
            supply = robot.conductor.supply
            assert supply is not None
            supply.line.cut()
        robot.put(keys.ESTOP)
        judge.foreign = 0
        judge.nothing_stopped_is_fed()
        if what == "estop and reset":
            robot.put(keys.RESET, {"estop": robot.state().estop})
    elif what == "ask estop":
        judge.off_is_off(keys.ESTOP, b"", SERVO_IDS)
    elif what == "ask stop":
        judge.off_is_off(keys.leg_command(number), leg("stop"), [10 * number + joint for joint in (1, 2, 3)])
    elif what in ("second board", "real board goes", "one board again"):
        exchange(judge, what)
    elif what in ("SPI fails", "SPI works"):
        fail(robot, fails=what == "SPI fails")
    else:
        disturb(judge, what, 0b111 << 3 * (number - 1))


def exchange(judge: Judge, what: str) -> None:
    """Exchange boards. A real one that is unplugged before anybody could see two is not judged."""
    line, now_ns = judge.robot.line, judge.robot.now_ns()
    judge.faulty_ns = now_ns
    if what == "second board" and line.second is None:
        line.second, judge.second_ns = SimulatedBoard(now_ns), now_ns
    elif what == "real board goes" and judge.second_ns is not None and now_ns - judge.second_ns > SEEN_NS:
        if line.second is not None and line.cable and not line.deaf and line.hears:
            line.board, line.second = line.second, None
    elif what == "one board again" and line.board is judge.real:
        line.second = judge.second_ns = None


def disturb(judge: Judge, what: str, mask: int) -> None:
    """Disturb the board or its link."""
    line, now_ns = judge.robot.line, judge.robot.now_ns()
    match what:
        case "unplug" | "plug":
            line.cable = what != "unplug"
        case "deaf" | "obeys":
            line.deaf = what == "deaf"
        case "mute" | "speaks":
            line.hears = what == "speaks"
        case "restart":
            line.board.restart()
            line.board.press_button(now_ns)
        case "press":
            line.board.press_button(now_ns)
        case "another asks":
            for question in ASK_RAILS:
                line.hear_from_another(question)
        case "block":
            line.board.fail(SERVO_OVERCURRENT, mask)
        case "by hand":
            line.board.clear_by_hand()
        case "unseen none":
            judge.faulty_ns = now_ns
            line.board.take(set_supply(0), now_ns)
        case "unseen blocked":
            judge.foreign |= mask
            line.board.take(set_supply(line.board.fed | mask), now_ns)
            line.board.fail(SERVO_OVERCURRENT, mask)
        case _:
            masks = {"another all": ALL, "another none": 0, "another some": mask}
            line.hear_from_another(set_supply(masks[what]))


def command(judge: Judge, what: str, number: int) -> None:
    """Send a command, and tell the judge of it."""
    robot, angle_deg = judge.robot, 60.0 + number
    ids = [10 * number + joint for joint in (1, 2, 3)]
    angles = (angle_deg,) * 3
    op, _, of = what.partition(" ")
    payloads: dict[str, tuple[str, dict[str, Any]]] = {
        "leg": (keys.leg_command(number), leg(op, *(() if op == "stop" else angles))),
        "servo": (keys.servo_command(ids[0]), servo(op, None if op == "stop" else angle_deg)),
        "all": (keys.LEGS_COMMAND, all_legs(op, angle_deg)),
    }
    named = {"leg": ids, "servo": ids[:1], "all": list(SERVO_IDS)}[of]
    if op == "start":
        before = {servo_id: (judge.started_ns[servo_id], judge.angles[servo_id]) for servo_id in named}
        judge.started(named, angle_deg)
        answers = robot.get(*payloads[of])
        if answers and not answers[0].accepted:
            for servo_id, (at_ns, angles_deg) in before.items():
                judge.started_ns[servo_id], judge.angles[servo_id] = at_ns, angles_deg
        return
    if op == "set":
        for servo_id in named:
            judge.angles[servo_id].add(angle_deg)
    robot.put(*payloads[of])
    if op == "stop":
        judge.nothing_stopped_is_fed()


def fail(robot: AnyRobot, *, fails: bool) -> None:
    """Let the way to the controller fail, or work again."""
    if isinstance(robot, FedElkapod):
        robot.elkapod.spi_fails = fails
    else:
        robot.controller.fail_where(lambda _: fails)


async def play(make: Callable[..., AnyRobot], steps: list[tuple[str, int, float]]) -> None:
    """Do each step, and let some time pass after it."""
    robot = make(watchdog={"timeout_ms": 3000})
    judge = Judge(robot)
    await asyncio.sleep(2.5)
    for what, number, seconds in steps:
        do(judge, what, number)
        await asyncio.sleep(seconds)
    await an_emergency_stop_ends_it(judge)
    robot.conductor.close()


async def an_emergency_stop_ends_it(judge: Judge) -> None:
    """Check that with a working link an emergency stop cuts all, is confirmed, and all comes back."""
    robot, line = judge.robot, judge.robot.line
    line.cable, line.deaf, line.hears = True, False, True
    line.board, line.second = judge.real, None
    fail(robot, fails=False)
    await asyncio.sleep(0.5)  # a reset is rejected while the bus is at fault
    robot.put(keys.ESTOP)
    robot.put(keys.RESET, {"estop": robot.state().estop})
    await asyncio.sleep(0.5)
    answers = robot.get(keys.ESTOP)
    assert line.fed() == frozenset()
    await asyncio.sleep(1.5)
    (ack,) = answers
    assert ack.confirmed or ack.confirmed_ms is None
    assert line.status.alive
    assert line.status.confirmed


@settings(max_examples=25, deadline=None)
@given(STEPS, st.sampled_from([FedRobot, FedElkapod]))
def test_no_order_of_events_feeds_a_servo_that_nobody_started(
    steps: list[tuple[str, int, float]], make: Callable[[], AnyRobot]
) -> None:
    loop = async_solipsism.EventLoop()
    errors: list[Any] = []
    loop.set_exception_handler(lambda _, context: errors.append(context.get("exception", context)))
    try:
        loop.run_until_complete(play(make, steps))
    finally:
        loop.close()
        if errors:
            raise errors[0]
