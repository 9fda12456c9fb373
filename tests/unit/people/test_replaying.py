"""What is sent for recorded frames, and whether two lists of frames are the same."""

import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from gateway.errors import ConfigError
from gateway.people.recordings.comparing import NS_PER_MS, Comparison, Frames, Sent, Written
from gateway.people.recordings.comparing import compare as compare_frames
from gateway.people.recordings.replaying import APART_NS, Expected, Plan, Step, steps_of, survey
from gateway.people.recordings.user_angles import UserAngles
from gateway.people.tools.replay import _ask, _fit
from gateway.robot.protocol.frames import OneLeg, OneServo, Op, ServoOp, stop_leg
from schemas.command import SERVO_COMMAND, LegCommand, LegsCommand
from schemas.keys import CALIBRATION, STATE
from schemas.robot import LEGS
from schemas.telemetry import Cause, GatewayState, Mode, WatchdogReport

BEGUN_NS: Final = 7_000_000_000


def leg(number: int, op: Op = Op.SET, deg: float = 90) -> OneLeg:
    return OneLeg(number, (ServoOp(op, round(100 * deg)),) * 3)


def record(at_ms: float, frame: OneLeg | OneServo, cause: Cause = Cause.COMMAND) -> dict[str, Any]:
    return {
        "monotonic_ns": BEGUN_NS + round(at_ms * NS_PER_MS),
        "bytes": frame.to_bytes().hex(),
        "cause": str(cause),
        "time": "2026-11-22T00:00:00Z",
    }


class Planned(NamedTuple):
    """What is sent and expected, as objects, and what it comes to."""

    steps: list[Step]
    expected: list[Written]
    recorded_ns: Sequence[int]
    plan: Plan


def plan(records: Iterable[Mapping[str, Any]], *, watchdog_too: bool = False) -> Planned:
    records = list(records)
    found = Expected()
    steps = list(steps_of(records, watchdog_too=watchdog_too, expected=found))
    frames = [found.frames.frame(place) for place in range(len(found.frames))]
    return Planned(steps, frames, found.recorded_ns, survey(records, lambda _: None))


def sending(*times_ns: tuple[int, int]) -> Sent:
    found = Sent()
    for begun_ns, done_ns in times_ns:
        found.append(begun_ns, done_ns)
    return found


def compare(
    planned: Planned, sent: Sequence[tuple[int, int]], written: Sequence[Written], tolerance_ms: float
) -> Comparison:
    recorded_ns = planned.recorded_ns
    return compare_frames(Frames(planned.expected), recorded_ns, sending(*sent), Frames(written), tolerance_ms)


def sent(*records: dict[str, Any], watchdog_too: bool = False) -> list[tuple[float, str, dict[str, Any]]]:
    found = plan(records, watchdog_too=watchdog_too)
    return [(step.at_ns / NS_PER_MS, step.key, step.payload()) for step in found.steps]


def test_frames_become_the_commands_that_cause_them() -> None:
    servo = OneServo(32, ServoOp(Op.SET, 12_34))
    found = sent(record(0, leg(3, Op.START)), record(20, servo), record(40, stop_leg(3)))
    assert found == [
        (0, "hexapod/leg/3/cmd", {"servos": [{"op": "start", "angle_deg": 90.0}] * 3}),
        (20, "hexapod/servo/32/cmd", {"op": "set", "angle_deg": 12.34}),
        (40, "hexapod/leg/3/cmd", {"servos": [{"op": "stop"}] * 3}),
    ]
    LegCommand.model_validate_json(str(found[0][2]).replace("'", '"'))
    SERVO_COMMAND.validate_json(str(found[1][2]).replace("'", '"'))


def test_six_legs_of_one_message_are_one_message() -> None:
    first = [record(0.1 * number, leg(number, Op.START)) for number in LEGS]
    second = [record(20 + 0.1 * number, leg(number, deg=91)) for number in LEGS]
    found = sent(*first, *second)
    assert [(at, key, sorted(payload["legs"])) for at, key, payload in found] == [
        (0, "hexapod/legs/cmd", list("123456")),
        (pytest.approx(20), "hexapod/legs/cmd", list("123456")),
    ]
    LegsCommand.model_validate_json(str(found[0][2]).replace("'", '"'))


@pytest.mark.parametrize(
    "other",
    [leg(2, Op.START), leg(4, Op.START), stop_leg(5), OneServo(61, ServoOp(Op.START, 0))],
    ids=("an earlier leg", "the same leg", "a Stop", "a servo"),
)
def test_what_one_message_cannot_cause_in_this_order_is_sent_apart(other: OneLeg | OneServo) -> None:
    found = plan([record(0, leg(4, Op.START)), record(0.2, other)])
    assert len(found.steps) == 2
    apart_ns = found.steps[1].at_ns - found.steps[0].at_ns
    assert apart_ns == (APART_NS if found.steps[0].key != found.steps[1].key else 200_000)


def test_what_the_gateway_does_by_itself_is_not_sent_but_expected() -> None:
    records = [
        record(-50, stop_leg(1), Cause.STARTUP),
        record(-30, stop_leg(1), Cause.REPEAT),
        record(0, leg(1, Op.START)),
        record(250, stop_leg(1), Cause.WATCHDOG),
        record(270, stop_leg(1), Cause.REPEAT),
        record(500, leg(1, Op.START)),
        *(record(600 + number, stop_leg(number), Cause.ESTOP) for number in LEGS),
    ]
    assert [at for at, _, _ in sent(*records)] == [0, 500, *(pytest.approx(600 + number) for number in (1, 4))]
    assert [at for at, _, _ in sent(*records, watchdog_too=True)][:3] == [0, 250, 500]
    assert [frame.at_ns // NS_PER_MS for frame in plan(records).expected[:4]] == [0, 250, 270, 500]


def test_a_recording_of_legs_that_ran_already_starts_them() -> None:
    found = plan([record(0, leg(1)), record(20, leg(1)), record(30, leg(2))])
    assert [step.payload()["servos"][0]["op"] for step in found.steps] == ["start", "set", "start"]
    assert found.plan.begun_running == 6
    assert found.expected[0].data == leg(1, Op.START).to_bytes()


def test_a_gap_counts_only_while_the_leg_runs() -> None:
    records = [record(0, leg(1, Op.START)), record(30, leg(1)), record(40, stop_leg(1)), record(9000, leg(1, Op.START))]
    assert plan(records).plan.longest_gap_ns == 30 * NS_PER_MS


@pytest.mark.parametrize("at_ms", [-5000, 3 * 3600 * 1000])
def test_after_the_machine_was_started_again_nothing_is_sent(at_ms: float) -> None:
    found = plan([record(0, leg(1, Op.START)), record(at_ms, leg(1)), record(at_ms + 20, leg(1))])
    assert (len(found.steps), found.plan.left_out) == (1, 2)


def test_frames_of_another_protocol_are_left_out() -> None:
    found = plan([record(0, leg(1, Op.START)), {**record(20, leg(1)), "bytes": "ff00"}, record(40, leg(1))])
    assert (len(found.steps), found.plan.left_out) == (2, 1)


@pytest.mark.parametrize("calibrated", [False, True])
@pytest.mark.parametrize("field", ["monotonic_ns", "bytes", "cause"])
@pytest.mark.parametrize("value", [None, [1], {}, "missing"], ids=repr)
def test_frames_that_lack_something_are_left_out(field: str, value: object, calibrated: bool) -> None:
    """Of a later version, or made by a program of somebody else's."""
    broken = {**record(10, leg(1)), field: value}
    if value == "missing":
        del broken[field]
    angles = UserAngles()
    if calibrated:
        angles.take(CALIBRATION, {"revision": 1, "servos": {"11": {"trim_deg": 3}}})
    angles.take(STATE, {"calibration": value})
    records = [broken, record(20, leg(1, Op.START)), broken, record(40, leg(1))]
    found = plan(angles.record(each) for each in records)
    assert (len(found.steps), found.plan.left_out) == (2, 2)


# ---- comparing

GAIT: Final = plan(
    [record(20 * step + 0.1 * number, leg(number, deg=90 + step)) for step in range(50) for number in LEGS]
)
PUNCTUAL: Final = [(step.at_ns, step.at_ns) for step in GAIT.steps]


def shifted(frames: Sequence[Written], ns: int) -> list[Written]:
    return [frame._replace(at_ns=frame.at_ns + ns) for frame in frames]


def test_the_same_frames_are_the_same_whenever_they_began() -> None:
    found = compare(GAIT, PUNCTUAL, shifted(GAIT.expected, 10**12), 0)
    assert found.passes
    assert found.frames == 300


def test_a_frame_that_comes_late_is_reported() -> None:
    late = shifted(GAIT.expected, 5)
    late[100:101] = shifted(late[100:101], 900_000)
    found = compare(GAIT, PUNCTUAL, late, 0.8)
    assert found.worst_ms == pytest.approx(0.9)
    assert (found.passes, found.beyond) == (False, 1)
    assert found.worst_at_s == pytest.approx(0.320, abs=1e-3)
    assert compare(GAIT, PUNCTUAL, late, 1).passes


def test_other_bytes_are_reported() -> None:
    other = list(GAIT.expected)
    other[12] = other[12]._replace(data=leg(1, deg=10).to_bytes())
    found = compare(GAIT, PUNCTUAL, other, 5)
    assert not found.passes
    assert found.differences[0].startswith(
        "leg 1: 49 frames are the same, 1 different; the first: at 0.040 s 0e010b030a"
    )
    assert found.same == 299


def test_a_missing_frame_is_reported() -> None:
    found = compare(GAIT, PUNCTUAL, GAIT.expected[:-1], 5)
    assert found.differences[0].startswith("leg 6: 49 frames are the same, 1 missing; the first: at 0.981 s 0e01")
    longer = [*GAIT.expected, Written(10**9, leg(6).to_bytes())]
    assert compare(GAIT, PUNCTUAL, longer, 5).differences[0].endswith(" was added")
    assert not compare(GAIT, PUNCTUAL, [], 5).passes


def test_legs_in_another_order_are_reported() -> None:
    frames = GAIT.expected
    found = compare(GAIT, PUNCTUAL, [*frames[:6], frames[7], frames[6], *frames[8:]], 5)
    assert not found.differences
    assert found.swapped == 1
    assert not found.passes


def test_the_gateways_own_frames_may_come_before_or_after_those_of_other_legs() -> None:
    first = [record(0.1 * number, leg(number)) for number in LEGS]
    expected = plan([*first[:5], record(0.55, stop_leg(3), Cause.REPEAT), first[5]])
    *frames, repeat, last = expected.expected
    assert (repeat.commanded, last.commanded) == (False, True)
    assert compare(expected, PUNCTUAL[:1], [*frames, last, repeat], 5).swapped == 0


def test_a_command_that_was_sent_late_is_expected_late() -> None:
    sent = list(PUNCTUAL)
    sent[10] = (sent[10][0] + 3_000_000, sent[10][1] + 3_000_000)
    late = [*GAIT.expected[:60], *shifted(GAIT.expected[60:66], 3_000_000), *GAIT.expected[66:]]
    assert compare(GAIT, sent, shifted(late, 7), 0).passes
    assert compare(GAIT, PUNCTUAL, late, 5).worst_ms == pytest.approx(3)
    assert compare(GAIT, sent, GAIT.expected, 5).worst_ms == pytest.approx(3), "it cannot be written before it was sent"


def test_within_the_time_that_sending_took_nobody_knows_when_it_left() -> None:
    sent = list(PUNCTUAL)
    sent[10] = (sent[10][0], sent[10][1] + 4_000_000)
    for after_ns in (0, 2_000_000, 4_000_000):
        frames = [*GAIT.expected[:60], *shifted(GAIT.expected[60:66], after_ns), *GAIT.expected[66:]]
        assert compare(GAIT, sent, frames, 0).passes
    frames = [*GAIT.expected[:60], *shifted(GAIT.expected[60:66], 4_500_000), *GAIT.expected[66:]]
    assert compare(GAIT, sent, frames, 5).worst_ms == pytest.approx(0.5)


def test_what_the_gateway_does_by_itself_is_expected_so_long_after_the_legs_last_command() -> None:
    others = [record(20.0 * step, leg(2)) for step in range(1, 12)]
    own = [record(250, stop_leg(1), Cause.WATCHDOG), record(270, stop_leg(1), Cause.REPEAT)]
    expected = plan([record(0, leg(1)), *others, *own])
    late_ns = 2_000_000
    sent = [(step.at_ns, step.at_ns) for step in expected.steps]
    sent[0] = (late_ns, late_ns)
    written = [frame._replace(at_ns=frame.at_ns + late_ns * (frame.data[2] == 11)) for frame in expected.expected]
    assert [frame.commanded for frame in written].count(False) == 2
    assert compare(expected, sent, written, 0).passes


def test_what_is_sent_apart_from_what_it_was_written_with_is_expected_apart() -> None:
    expected = plan([record(0, leg(4)), record(0.2, OneServo(61, ServoOp(Op.START, 0)))])
    sent = [(step.at_ns, step.at_ns) for step in expected.steps]
    written = [expected.expected[0], expected.expected[1]._replace(at_ns=APART_NS)]
    assert compare(expected, sent, written, 0).passes


# ---- past a difference

LONG: Final = plan(
    [
        record(20 * step + 0.1 * number, leg(number, deg=20 + step % 1500 / 10))
        for step in range(3000)
        for number in LEGS
    ]
)
LONG_SENT: Final = [(step.at_ns, step.at_ns) for step in LONG.steps]
STANDING: Final = plan([record(20 * step + 0.1 * number, leg(number)) for step in range(3000) for number in LEGS])


@pytest.mark.parametrize("planned", [LONG, STANDING], ids=["walking", "standing"])
@pytest.mark.parametrize(("begin", "steps"), [(50, 1), (50, 7), (50, 600), (0, 1), (2999, 1)])
def test_after_steps_that_are_missing_the_rest_is_compared_and_timed(planned: Planned, begin: int, steps: int) -> None:
    """A gateway that stood still, or was sent two setpoints at once, writes only the newer of them."""
    rest = [*planned.expected[: 6 * begin], *planned.expected[6 * (begin + steps) :]]
    found = compare(planned, LONG_SENT, shifted(rest, 10**12), 1)
    assert found.same == len(rest)
    assert len(found.differences) == 6
    assert f"leg 3: {3000 - steps} frames are the same, {steps} missing; the first: at " in found.differences[2]
    assert (found.beyond, found.swapped, found.passes) == (0, 0, False)
    late = [*rest[:-60], *shifted(rest[-60:], 3 * NS_PER_MS)]
    assert compare(planned, LONG_SENT, late, 1).beyond == 60, "what is late behind it is late"


def test_a_frame_of_the_same_bytes_that_is_late_is_not_taken_for_its_neighbour() -> None:
    late = list(STANDING.expected)
    late[600:606] = shifted(late[600:606], 15 * NS_PER_MS)
    found = compare(STANDING, LONG_SENT, late, 1)
    assert (found.differences, found.beyond) == ([], 6)
    assert found.worst_ms == pytest.approx(15)


def test_what_is_different_throughout_is_reported_in_a_time_that_grows_with_its_length() -> None:
    other = [frame._replace(data=leg(frame.data[2] // 10, deg=1).to_bytes()) for frame in LONG.expected]
    found = compare(LONG, LONG_SENT, other, 1)
    assert (found.same, len(found.differences)) == (0, 6)
    assert all(
        each.startswith(f"leg {number}: 0 frames are the same, 3000 different")
        for number, each in zip(LEGS, found.differences, strict=True)
    )


@given(
    st.lists(
        st.tuples(st.integers(0, 299).map(lambda tenth: 10 * tenth), st.sampled_from(["miss", "add", "change"])),
        max_size=20,
    )
)
@settings(max_examples=5, deadline=None, phases=[Phase.explicit, Phase.generate])
def test_whatever_differs_in_a_walk_all_else_is_the_same(faults: list[tuple[int, str]]) -> None:
    written: list[list[Written]] = [[frame] for frame in LONG.expected]
    strange = leg(1, deg=179).to_bytes()
    for step, fault in faults:
        frame = LONG.expected[6 * step]
        written[6 * step] = {
            "miss": [], "add": [frame._replace(data=strange), frame], "change": [frame._replace(data=strange)]
        }[fault]  # fmt: skip
    kinds = dict(faults)
    found = compare(LONG, LONG_SENT, [frame for frames in written for frame in frames], 1)
    assert found.same == 18_000 - sum(kind != "add" for kind in kinds.values())
    assert (found.beyond, found.swapped) == (0, 0)
    assert found.passes == (not faults)


def test_a_gap_that_the_watchdog_does_not_wait_for_is_reported_beforehand(capsys: pytest.CaptureFixture[str]) -> None:
    watchdog = WatchdogReport.model_construct(timeout_ms=250)
    state = GatewayState.model_construct(mode=Mode.IDLE, watchdog=watchdog)
    for gap_ms in (240, 312):
        _fit(state, plan([record(0, leg(1, Op.START)), record(gap_ms, leg(1))]).plan, 1)
        assert ("Once there are 312 ms" in capsys.readouterr().err) == (gap_ms == 312)
    with pytest.raises(ConfigError, match=r"at --speed 0\.5 there are 480 ms"):
        _fit(state, plan([record(0, leg(1, Op.START)), record(240, leg(1))]).plan, 0.5)


def test_a_real_robot_does_not_move_where_nobody_can_be_asked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = plan([record(0, leg(3, Op.START)), record(2000, stop_leg(3))]).plan
    monkeypatch.setattr("sys.stdin", io.StringIO("y\n"))
    with pytest.raises(ConfigError, match="--yes"):
        _ask(recorded, 1, agreed=False)
    _ask(recorded, 1, agreed=True)
    assert "Its legs 3 will go" in capsys.readouterr().err
