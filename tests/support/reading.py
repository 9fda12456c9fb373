"""What a message asks for, as a value that tests compare, and a second reading of the same JSON."""

import json
import math
from typing import Any, Final, NamedTuple

from gateway.model import frames
from gateway.model.frames import Frame, OneLeg, OneServo, Op, ServoOp, servo_ids_of
from gateway.robot.core.events import Command, Reset, Targets
from gateway.robot.core.intake import read
from gateway.robot.core.message import Received, Verb
from gateway.robot.core.rejections import Rejection
from schemas.command import MAX_SENT_MS
from schemas.keys import CommandKey, Target
from schemas.telemetry import Reason

MAX_DETAIL: Final = 200
"""Characters of an answer to a bad command; it goes out as an event and into the log for everyone to see."""
_UNREAD: Final = frozenset({Reason.TOO_LARGE, Reason.BAD_ENCODING, Reason.MALFORMED, Reason.INVALID})


class Intent(NamedTuple):
    """A command or a reset, without how it came."""

    targets: Targets = ()
    source: str | None = None
    sent_ms: float | None = None
    estop: int | None = None
    lease: str | None = None


def meant(answer: Command | Reset | Rejection) -> Intent | Rejection:
    """The intent of what was read."""
    if isinstance(answer, Rejection):
        return answer
    estop = answer.estop if isinstance(answer, Reset) else None
    return Intent(answer.targets, answer.source, answer.sent_ms, estop, answer.lease)


def decode(key: CommandKey, payload: bytes, encoding: str) -> Intent | Rejection:
    """What a `put` of this payload asks for."""
    return meant(read(Received("", "", key, Verb.PUT, payload, len(payload), encoding, None, 0)))


def check_intake(key: CommandKey, payload: bytes, answer: object) -> str:
    """An answer is an Intent that is true to the payload and makes legal frames, or a Rejection in one short line."""
    if isinstance(answer, Rejection):
        assert key.target is not Target.ESTOP
        assert answer.reason in _UNREAD
        assert 0 < len(answer.detail) <= MAX_DETAIL, answer.detail
        assert answer.detail.isprintable(), answer.detail
        return str(answer.reason)
    assert isinstance(answer, Intent)
    assert answer.source is None or 1 <= len(answer.source) <= 64
    assert answer.sent_ms is None or 0 <= answer.sent_ms <= MAX_SENT_MS
    if key.target is Target.ESTOP:
        assert answer == Intent()
        return "intent"
    sent = json.loads(payload or b"{}", object_pairs_hook=_with_every_name_once)
    assert isinstance(sent, dict)
    assert (answer.source, answer.estop) == (sent.get("source"), sent.get("estop"))
    assert (answer.sent_ms is None) == (sent.get("sent_ms") is None)
    assert answer.sent_ms is None or math.isclose(answer.sent_ms, sent["sent_ms"])
    if key.target is Target.RESET:
        assert sent.keys() <= {"estop", "source", "sent_ms"}
        assert answer.targets == ()
        return "intent"
    _check_targets(key, sent, answer.targets)
    for frame in _frames_of(answer.targets):
        assert frames.decode(frame.to_bytes()) == frame
    return "intent"


def _with_every_name_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    assert len(dict(pairs)) == len(pairs), pairs
    return dict(pairs)


def _check_targets(key: CommandKey, sent: dict[str, Any], targets: Targets) -> None:
    """Compare with another reading of the same JSON, by the standard library and by hand."""
    assert sent.keys() <= {"op", "angle_deg", "servos", "legs", "source", "sent_ms"}
    match key.target:
        case Target.SERVO:
            wanted = [(key.number, sent)]
        case Target.LEG:
            wanted = list(zip(servo_ids_of(key.number), sent["servos"], strict=True))
        case _:
            assert 1 <= len(sent["legs"]) <= 6
            wanted = [
                pair
                for leg in sorted(sent["legs"])
                for pair in zip(servo_ids_of(int(leg)), sent["legs"][leg]["servos"], strict=True)
            ]
    assert [servo_id for servo_id, _ in targets] == [servo_id for servo_id, _ in wanted]
    for (_, command), (_, setpoint) in zip(targets, wanted, strict=True):
        assert command.op is {"start": Op.START, "stop": Op.STOP, "set": Op.SET}[setpoint["op"]]
        if command.op is Op.STOP:
            assert "angle_deg" not in setpoint
            continue
        angle_deg = setpoint["angle_deg"]
        assert type(angle_deg) in (int, float)
        assert 0 <= angle_deg <= 180
        assert math.isclose(command.angle_cdeg, 100 * angle_deg, rel_tol=0, abs_tol=0.5 + 1e-9)


def _frames_of(targets: Targets) -> list[Frame]:
    """The frames that these targets become: whole legs as ONE LEG, a single servo as ONE SERVO."""
    if len(targets) == 1:
        return [OneServo(*targets[0])]
    ops: list[ServoOp] = [op for _, op in targets]
    return [OneLeg(targets[i][0] // 10, (ops[i], ops[i + 1], ops[i + 2])) for i in range(0, len(targets), 3)]
