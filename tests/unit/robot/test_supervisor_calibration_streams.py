"""Whatever comes: the default calibration changes no byte, and another one nothing but the angles on the wire."""

from dataclasses import dataclass, replace

from hypothesis import given
from hypothesis import strategies as st

from gateway.robot.core.calibration import Calibration, ServoCalibration
from gateway.robot.core.events import (
    BusFailed,
    BusOpened,
    Command,
    Completed,
    Effect,
    EmergencyStop,
    Event,
    Rejected,
    Reset,
    StoppedOutside,
    TimePassed,
    Transmit,
)
from gateway.robot.core.leg import Rules
from gateway.robot.core.pacing import NS_PER_MS
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.protocol.frames import STOP, Op, ServoOp, decode, servo_ids_of
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Reason
from tests.support.transitions import TRANSITIONS
from tests.unit.robot.test_calibration import angles, calibrations

MOST_TRIM_CDEG = 20_00
RULES = (
    Rules(),
    Rules(landing_ns=500 * NS_PER_MS, landing_cdeg={11: 90_00, 23: 20_00, 62: 160_00}),
    Rules(max_speed_cdeg_s=dict.fromkeys(SERVO_IDS, 100_00), landing_ns=300 * NS_PER_MS, landing_cdeg={32: 90_00}),
    Rules(joint_limits_cdeg={11: (30_00, 150_00)}, start_pause_ns=30 * NS_PER_MS, whole_robot=True),
)
within_reach = st.integers(MOST_TRIM_CDEG, 180_00 - MOST_TRIM_CDEG)
"""Angles that a servo with so much trim has, whichever way it turns."""
ops = st.builds(ServoOp, st.sampled_from((Op.START, Op.START, Op.SET)), within_reach) | st.just(STOP)
targets = st.one_of(
    st.dictionaries(st.sampled_from(SERVO_IDS), ops, min_size=1, max_size=4).map(lambda each: tuple(each.items())),
    st.builds(lambda leg, op: tuple((servo_id, op) for servo_id in servo_ids_of(leg)), st.sampled_from(LEGS), ops),
    st.builds(lambda op: tuple((servo_id, op) for servo_id in SERVO_IDS), ops),
)
commands = st.builds(Command, st.just(0), st.sampled_from(("put", "get")), targets)
happenings = st.one_of(
    commands,
    commands,
    commands,
    st.just(TimePassed()),
    st.sampled_from((EmergencyStop(), Reset(0), BusFailed("EIO"), BusOpened(), StoppedOutside(False))),
)
streams = st.lists(st.tuples(st.sampled_from((0, 1, 6, 20, 100, 260)), happenings), max_size=60)
trimmed = st.dictionaries(
    st.sampled_from(SERVO_IDS),
    st.builds(
        ServoCalibration, st.integers(-MOST_TRIM_CDEG, MOST_TRIM_CDEG), st.booleans(), st.just(0), st.just(180_00)
    ),
    max_size=8,
)


@dataclass
class _Numbered:
    """The events of a stream as a supervisor takes them: only those that may come, each command with its number."""

    supervisor: Supervisor
    number: int = 0

    def take(self, event: Event, now_ns: int) -> list[Effect]:
        if type(event) not in TRANSITIONS[self.supervisor.mode]:
            return []
        self.number += 1
        if isinstance(event, Command):
            event = Command(self.number, event.channel, event.targets)
        elif isinstance(event, Reset):
            event = Reset(self.number, estop=self.supervisor.estops)
        return self.supervisor.step(event, now_ns)


def as_users_count(effects: list[Effect], calibration: Calibration) -> list[Effect]:
    return [
        replace(effect, frame=calibration.user_frame(decode(effect.frame.to_bytes())))
        if isinstance(effect, Transmit)
        else effect
        for effect in effects
    ]


def bytes_of(effects: list[Effect]) -> list[bytes]:
    return [effect.frame.to_bytes() for effect in effects if isinstance(effect, Transmit)]


@given(st.sampled_from(RULES), streams, trimmed, st.booleans())
def test_a_calibration_changes_nothing_but_the_angles_on_the_wire(
    rules: Rules, stream: list[tuple[int, Event]], servos: dict[int, ServoCalibration], wakes: bool
) -> None:
    """Beside a robot that no calibration was ever loaded for: the same frames, answers and times."""
    plain, default, calibrated = (_Numbered(Supervisor(rules)) for _ in range(3))
    calibration = Calibration(4, servos)
    default.supervisor.calibrating.load(Calibration(9, dict.fromkeys(SERVO_IDS, ServoCalibration())))
    calibrated.supervisor.calibrating.load(calibration)
    now_ns = 1
    for wait_ms, event in ((0, BusOpened()), *stream):
        until_ns = now_ns + wait_ms * NS_PER_MS
        while wakes and (due_ns := plain.supervisor.due_ns) is not None and due_ns <= until_ns:
            now_ns = max(now_ns, due_ns)
            _agree(plain, default, calibrated, calibration, TimePassed(), now_ns)
        now_ns = until_ns
        _agree(plain, default, calibrated, calibration, event, now_ns)


def _agree(
    plain: _Numbered, default: _Numbered, calibrated: _Numbered, calibration: Calibration, event: Event, now_ns: int
) -> None:
    effects = plain.take(event, now_ns)
    same = default.take(event, now_ns)
    assert same == effects
    assert bytes_of(same) == bytes_of(effects)
    assert as_users_count(calibrated.take(event, now_ns), calibration) == effects
    for other in (default, calibrated):
        assert other.supervisor.due_ns == plain.supervisor.due_ns
        assert other.supervisor.mode == plain.supervisor.mode


@given(calibrations, st.sampled_from(SERVO_IDS), angles)
def test_a_start_is_sent_as_its_user_meant_it_or_not_at_all(
    calibration: Calibration, servo_id: int, angle_cdeg: int
) -> None:
    supervisor = Supervisor(Rules())
    supervisor.calibrating.load(calibration)
    supervisor.step(BusOpened(), 1)
    start = ServoOp(Op.START, angle_cdeg)
    effects = supervisor.step(Command(1, "put", ((servo_id, start),)), 2)
    if isinstance(effects[0], Rejected):
        assert effects[0].reason is Reason.JOINT_LIMIT
        assert calibration.why_not(servo_id, angle_cdeg) == effects[0].detail
        assert supervisor.legs.servos[servo_id].angle_cdeg is None
        return
    sent, answer = as_users_count(effects, calibration)
    assert isinstance(sent, Transmit)
    assert sent.frame.servos == ((servo_id, start),)
    assert answer == Completed(1)
    assert supervisor.legs.servos[servo_id].angle_cdeg == angle_cdeg
