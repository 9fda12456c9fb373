"""When a leg may send, and what; and the life of a servo: every state with every event, and who may change it."""

import ast
from collections.abc import Callable, Iterator
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Final

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.model.angle_limits import AngleLimits
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import SETS, STARTS
from gateway.rate_limit import NS_PER_MS, NS_PER_S
from gateway.robot.core import servo as module
from gateway.robot.core.events import Command
from gateway.robot.core.leg import RateSlots, leg_at_rest
from gateway.robot.core.pace import Paces, step
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import AFTER, OFF, RUNNING, WAITING, IllegalTransition, Life, Servo, moved


def sent_at(period_ns: int, arrivals_ns: list[int]) -> list[int]:
    """Return when frames go out, each with the newest that has arrived. What is pending leaves when it is due."""
    slots = RateSlots(period_ns)
    frames_ns: list[int] = []
    pending = False
    for now_ns in arrivals_ns:
        if pending and slots.next_ns < now_ns:
            frames_ns.append(slots.next_ns)
            slots.take(slots.next_ns)
        pending = now_ns < slots.next_ns
        if not pending:
            frames_ns.append(now_ns)
            slots.take(now_ns)
    return frames_ns + [slots.next_ns] * pending


def test_three_slots_are_kept_and_used_a_quarter_of_a_period_apart() -> None:
    """Nothing was sent for long: no more than three, and no burst."""
    assert sent_at(100, [1000, 1001, 1026, 1051, 1052]) == [1000, 1025, 1050, 1100]


@given(st.integers(2, 101), st.data())
def test_in_the_long_run_more_than_the_rate_gets_exactly_the_rate(period_ns: int, data: st.DataObject) -> None:
    """As soon as the bucket is empty, one frame in every period, to the nanosecond."""
    gap_ns = data.draw(st.integers(1, period_ns - 1))
    frames = sent_at(period_ns, list(range(1000, 1000 + 400 * period_ns, gap_ns)))
    empty = 2 + 3 * period_ns // (period_ns - gap_ns)  # a stream that is only just too fast takes long to empty it
    assert all(later - earlier == period_ns for earlier, later in pairwise(frames[empty:]))


# ---- A limited speed: never more than speed times time, and the target is reached


angles = st.integers(0, 180_00)
speeds = st.integers(1, 1000_00)


waits = st.integers(0, 200 * NS_PER_MS)
periods = st.integers(NS_PER_MS, NS_PER_S)
LONG_NS = 10**6 * NS_PER_S
"""A rate slot that bounds nothing."""


@given(angles, speeds, periods, st.lists(st.tuples(angles, waits), min_size=1, max_size=50))
@example(0, 18981, LONG_NS, [(352, 158053), (352, 18386807)])
@example(0, 100_00, LONG_NS, [(1_00, 100 * NS_PER_MS), (180_00, 10 * NS_PER_MS)])  # there early, and then on
def test_never_more_than_speed_times_time(
    start: int, speed: int, period_ns: int, targets: list[tuple[int, int]]
) -> None:
    angle, since_ns, now_ns = start, 0, 0
    for target, wait_ns in targets:
        before = angle
        now_ns += wait_ns
        angle, since_ns = step(angle, target, speed, since_ns, now_ns, -(-speed * period_ns // NS_PER_S))
        assert abs(angle - before) * NS_PER_S < speed * period_ns + NS_PER_S, "no frame says more than a rate slot's"
        assert min(before, target) <= angle <= max(before, target)
        assert abs(angle - before) * NS_PER_S <= speed * wait_ns + NS_PER_S  # and rounding: a hundredth of a degree
        assert abs(angle - start) * NS_PER_S <= speed * now_ns  # which never adds up
        assert since_ns <= now_ns


def test_who_has_arrived_has_no_time_left_over() -> None:
    assert step(0, 1_00, 100_00, 0, 10 * NS_PER_MS + 1, 180_00) == (1_00, 10 * NS_PER_MS + 1)


# ---- The way down: a straight line, its ends never left, in time


PERIOD_NS = 20 * NS_PER_MS


@given(angles, angles, st.integers(0, 5000), st.integers(0, 4000), st.lists(st.integers(0, 5000)))
@example(150_00, 30_00, 1000, 975, [980])  # a stall before it: 25 ms are left for 120 degrees
@example(150_00, 30_00, 1000, 0, [*range(20, 300, 20), 900, 920])  # a stall in its middle
def test_no_frame_of_a_landing_has_more_than_a_rate_slot_s_part(
    first: int, last: int, length_ms: int, late_ms: int, times_ms: list[int]
) -> None:
    """However late it begins, and whatever stalls come: what does not arrive in time is stopped where it is."""
    pace = Paces(Rules(period_ns=PERIOD_NS, landing_ns=length_ms * NS_PER_MS), AngleLimits())
    servo = Servo(32, RUNNING, first)
    pace.land(servo, last, late_ms * NS_PER_MS)
    said = [first]
    for at_ms in sorted(times_ms):
        if servo.target is not None:
            said.append(pace.step(servo, (late_ms + at_ms) * NS_PER_MS, 0, lands=True).angle_cdeg)
    slots = max(1.0, length_ms / 20 - 2)
    for before, after in pairwise(said):
        assert abs(after - before) <= abs(last - first) / slots + 1
        assert min(first, last) <= after <= max(first, last)


@given(angles, angles, st.integers(60, 5000))
def test_a_landing_in_time_arrives_two_rate_slots_before_its_end(first: int, last: int, length_ms: int) -> None:
    pace = Paces(Rules(period_ns=PERIOD_NS, landing_ns=length_ms * NS_PER_MS), AngleLimits())
    servo = Servo(32, RUNNING, first)
    pace.land(servo, last, 0)
    for now_ns in range(PERIOD_NS, length_ms * NS_PER_MS - PERIOD_NS + 1, PERIOD_NS):
        if servo.target is not None:
            pace.step(servo, now_ns, 0, lands=True)
    assert servo.angle_cdeg == last


def test_what_a_landing_makes_up_for_has_the_servo_s_own_speed() -> None:
    pace = Paces(Rules(max_speed_cdeg_s={32: 10_00}, landing_ns=NS_PER_S), AngleLimits())
    servo = Servo(32, RUNNING, 0)
    pace.land(servo, 90_00, 0)
    assert pace.step(servo, 995 * NS_PER_MS, 0, lands=True).angle_cdeg == 20, "a rate slot's part, though it is late"
    assert pace.step(servo, 1000 * NS_PER_MS, 995 * NS_PER_MS, lands=True).angle_cdeg == 25, "5 ms after a frame"
    assert pace.step(servo, 1020 * NS_PER_MS, 1000 * NS_PER_MS, lands=True).angle_cdeg == 45


def test_a_servo_that_stands_at_its_landing_angle_gets_no_target() -> None:
    servo = Servo(32, RUNNING, 90_00)
    Paces(Rules(landing_ns=NS_PER_S), AngleLimits()).land(servo, 90_00, 0)
    assert servo.target is None


@pytest.mark.parametrize("angles_first", [True, False])
def test_a_start_begins_at_its_target_if_supply_starts_the_servo(angles_first: bool) -> None:
    pace = Paces(Rules(angles_first=angles_first, max_speed_cdeg_s={11: 1_00}), AngleLimits())
    servo, start = Servo(11), STARTS[90_00]
    assert pace.begin_cdeg(servo, start, 0) == (90_00 if angles_first else None)
    servo.take(start, COMMAND, pace.begin_cdeg(servo, start, 0))
    servo.take(SETS[80_00], COMMAND)
    assert pace.step(servo, NS_PER_S, 0, lands=False).angle_cdeg == (90_00 if angles_first else 80_00)
    assert servo.pace_cdeg_s is None, "no take-over is set"


@pytest.mark.parametrize("takeover_cdeg_s", [0, 180_00])
def test_another_source_is_eased_from_the_leg_s_last_frame_if_the_setting_says_so(takeover_cdeg_s: int) -> None:
    leg = leg_at_rest(1, PERIOD_NS)
    leg.slots.take(7)
    pace, servo = Paces(Rules(takeover_cdeg_s=takeover_cdeg_s), AngleLimits()), in_state(RUNNING)
    pace.take_over(leg, servo)
    assert (servo.pace_cdeg_s, servo.since_ns) == ((takeover_cdeg_s, 7) if takeover_cdeg_s else (None, 5))
    servo.ease(1, 8)
    pace.take_over(leg, servo)
    assert (servo.pace_cdeg_s, servo.since_ns) == (1, 8), "once, however often the source changes"
    pace.take_over(leg, waiting := in_state(WAITING))
    assert waiting.pace_cdeg_s is None, "its start sets its pace"


ROBOT: Final = Path(module.__file__).parents[1]
COMMAND: Final = Command(((11, STARTS[20_00]),), source="anna")
EVENTS: Final[dict[str, Callable[[Servo], object]]] = {
    "start": lambda servo: servo.take(STARTS[90_00], COMMAND),
    "set": lambda servo: servo.take(SETS[90_00], COMMAND),
    "frame": lambda servo: servo.wrote_target(7),
    "drop": lambda servo: servo.drop(),
    "stop": lambda servo: servo.stop("put leg", 6, 7, RobotCalibration()),
}


def in_state(life: Life) -> Servo:
    """Return a servo in this state; one that runs has a new target."""
    servo = Servo(11)
    if life is not OFF:
        servo.take(STARTS[20_00], COMMAND)
    if life is RUNNING:
        servo.wrote_target(5)
        servo.take(SETS[30_00], COMMAND)
    return servo


def moved_by_bert(servo: Servo) -> None:
    servo.take(SETS[30_00], Command((), source="bert"))
    servo.wrote_target(7)


NOT_STEADY: Final[dict[str, Callable[[Servo], object]]] = {
    "a pace": lambda servo: servo.ease(1, 5),
    "a way to go": lambda servo: servo.take(SETS[30_00], COMMAND),
    "a Stop": lambda servo: servo.stop("put leg", 6, 7, RobotCalibration()),
    "another sender": moved_by_bert,
}


@pytest.mark.parametrize("what", NOT_STEADY)
def test_a_leg_is_steady_while_all_its_servos_run_for_its_sender_without_a_way_to_go(what: str) -> None:
    leg = leg_at_rest(1, PERIOD_NS)
    leg.sender = COMMAND.sender
    for servo in leg.servos:
        servo.take(STARTS[20_00], COMMAND)
        servo.wrote_target(5)
    assert leg.is_steady_for(COMMAND.sender)
    NOT_STEADY[what](leg.servos[1])
    assert not leg.is_steady_for(COMMAND.sender)


def values(servo: Servo) -> list[object]:
    return [getattr(servo, each.name) for each in fields(Servo)]


@pytest.mark.parametrize("life", Life)
@pytest.mark.parametrize("event", EVENTS)
def test_each_event_leads_where_the_table_says_or_changes_nothing(event: str, life: Life) -> None:
    servo = in_state(life)
    before = values(servo)
    if life in AFTER[event]:
        EVENTS[event](servo)
        assert servo.life is AFTER[event][life]
        assert (servo.angle_cdeg is not None) is (servo.life is RUNNING)
        assert servo.target is not None or servo.life is not WAITING
    else:
        with pytest.raises(IllegalTransition, match="servo 11 is off"):
            EVENTS[event](servo)
        assert values(servo) == before


def test_a_stop_after_which_the_last_frame_is_unknown_forgets_the_angle() -> None:
    servo = in_state(RUNNING)
    servo.stop("estop", 6, 7, RobotCalibration())
    assert servo.known == (20_00, 7, RobotCalibration())
    servo.stop("startup", 8, 9, None)
    assert servo.known is None


def test_only_a_running_servo_without_a_target_goes_the_usual_way() -> None:
    for life in Life:
        servo = in_state(life)
        before = values(servo)
        with pytest.raises(IllegalTransition):
            moved({servo.servo_id: servo}, ((servo.servo_id, SETS[40_00]),))
        assert values(servo) == before


def assigned(path: Path) -> Iterator[str]:
    """Yield the names of the attributes that a file assigns."""
    for node in ast.walk(ast.parse(path.read_text())):
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets += [node.target] if isinstance(node, ast.AugAssign | ast.AnnAssign) else []
        for target in targets:
            for each in target.elts if isinstance(target, ast.Tuple) else (target,):
                if isinstance(each, ast.Attribute) and ast.unparse(each.value) != "self":
                    yield each.attr


def test_no_other_file_assigns_the_fields_of_a_servo() -> None:
    """Other values have some of these names, too, and assign them to `self`, or to what is no servo."""
    own = {each.name for each in fields(Servo)} - {"sender", "command"}
    found = {
        f"{path.name}: {name}"
        for path in ROBOT.rglob("*.py")
        if path != Path(module.__file__)
        for name in assigned(path)
        if name in own
    }
    assert not found
