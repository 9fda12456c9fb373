"""What is sent for recorded frames."""

import io
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple

import pytest

from gateway.allowance import NS_PER_MS
from gateway.errors import ConfigError
from gateway.model.frames import OneLeg, OneServo, Op, ServoOp, stop_leg
from gateway.people.recordings.replaying import APART_NS, Plan, ReplayStep, steps_of, survey
from gateway.people.recordings.user_angles import UserAngles
from gateway.people.tools.replay import _ask, _fit
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
    """What is sent, as objects, and what it comes to."""

    steps: list[ReplayStep]
    plan: Plan


def plan(records: Iterable[Mapping[str, Any]], *, watchdog_too: bool = False) -> Planned:
    records = list(records)
    return Planned(list(steps_of(records, watchdog_too=watchdog_too)), survey(records, lambda _: None))


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


def test_what_the_gateway_does_by_itself_is_not_sent() -> None:
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


def test_a_recording_of_legs_that_ran_already_starts_them() -> None:
    found = plan([record(0, leg(1)), record(20, leg(1)), record(30, leg(2))])
    assert [step.payload()["servos"][0]["op"] for step in found.steps] == ["start", "set", "start"]
    assert found.plan.begun_running == 6


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
