"""What is done with each fuzzed input, and what must hold: an AssertionError, or any other exception, is a finding.

Each check returns what became of the input, for the report to count.
"""

import contextlib
import io
import json
import math
from collections.abc import Callable
from typing import Any, Final

from gateway.model import frames
from gateway.model.frames import Frame, FrameError, OneLeg, OneServo, Op, ServoOp, servo_ids_of
from gateway.model.framing import Framing
from gateway.people.commands import decode as decode_command
from gateway.robot.core import intake
from gateway.robot.core.events import Targets
from gateway.simulation.controller import SimulatedController
from schemas.command import MAX_SENT_MS
from schemas.keys import COMMAND_KEYS, CommandKey, Target
from schemas.robot import SERVO_IDS
from schemas.telemetry import Reason
from tests.fuzz.reference import ReferenceController
from tests.support.reading import Intent, decode

MAX_DETAIL: Final = 200
"""Characters of an answer to a bad command; it goes out as an event and into the log for everyone to see."""

KEYS: Final = tuple(COMMAND_KEYS.values())
ENCODINGS: Final = ("application/json", "zenoh/bytes", "", "text/plain", "application/json;charset=utf-8")
_UNREAD: Final = frozenset({Reason.TOO_LARGE, Reason.BAD_ENCODING, Reason.MALFORMED, Reason.INVALID})


def fuzz_intake(data: bytes) -> str:
    """Byte 1 picks the key, byte 2 the encoding, the rest is the payload."""
    if len(data) < 2:
        return "too short"
    key, encoding, payload = KEYS[data[0] % len(KEYS)], ENCODINGS[data[1] % len(ENCODINGS)], data[2:]
    return check_intake(key, payload, decode(key, payload, encoding))


def check_intake(key: CommandKey, payload: bytes, answer: object) -> str:
    """An answer is an Intent that is true to the payload and makes legal frames, or a Rejection in one short line."""
    if isinstance(answer, intake.Rejection):
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
    assert_targets_are_what_was_sent(key, sent, answer.targets)
    for frame in frames_of(answer.targets):
        assert frames.decode(frame.to_bytes()) == frame
    return "intent"


def _with_every_name_once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    assert len(dict(pairs)) == len(pairs), pairs
    return dict(pairs)


def assert_targets_are_what_was_sent(key: CommandKey, sent: dict[str, Any], targets: Targets) -> None:
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


def frames_of(targets: Targets) -> list[Frame]:
    """The frames that these targets become: whole legs as ONE LEG, a single servo as ONE SERVO."""
    if len(targets) == 1:
        return [OneServo(*targets[0])]
    ops: list[ServoOp] = [op for _, op in targets]
    return [OneLeg(targets[i][0] // 10, (ops[i], ops[i + 1], ops[i + 2])) for i in range(0, len(targets), 3)]


def fuzz_decode(data: bytes) -> str:
    """An even first byte: the rest is a frame's bytes. An odd one: it is what somebody typed after `decode`."""
    if not data:
        return "too short"
    if data[0] % 2 == 0:
        return check_frame(data[1:])
    # As the operating system hands arguments over: no NUL, and bytes that are no UTF-8 as lone surrogates.
    return check_command(data[1:].replace(b"\0", b"").decode(errors="surrogateescape").split(" "))


def check_frame(data: bytes) -> str:
    """Bytes are a frame that is written as it was read (besides a Stop's angle), or the first wrong byte is named."""
    frame = frame_or_why_not(data)
    if isinstance(frame, str):
        assert frame.startswith("byte "), frame
        assert len(frame) <= MAX_DETAIL
        assert frame.isprintable()
        return "bytes: no frame"
    canonical = bytearray(data)
    for record in range(2, len(data), 4):
        if data[record + 1] == Op.STOP:
            canonical[record + 2 : record + 4] = b"\0\0"
    assert frame.to_bytes() == canonical
    return "bytes: frame"


def frame_or_why_not(data: bytes) -> Frame | str:
    try:
        return frames.decode(data)
    except FrameError as error:
        return str(error)


def check_command(typed: list[str]) -> str:
    """`decode` prints lines that any terminal takes, and its exit code is 0 or 1; 0 only if each line is a frame."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        code = decode_command.decode(typed)
    lines = printed.getvalue().splitlines()
    assert lines
    assert all(line.isprintable() for line in lines), lines
    printed.getvalue().encode()
    assert code in (0, 1)
    if code == 0:
        for line in lines:
            check_frame(bytes.fromhex(line.partition(":")[0]))
            assert ": ONE " in line
    return f"typed: exit code {code}"


def fuzz_simulator(data: bytes) -> str:
    """Bit 0 of byte 1 picks the framing. Then transfers: a byte of pause, a byte of length, and that many bytes."""
    if not data:
        return "too short"
    framing = (Framing.PLAIN, Framing.LENGTH_PREFIXED)[data[0] % 2]
    now_ns = 0
    controller = SimulatedController(framing, clock=lambda: now_ns)
    reference = ReferenceController(announced=framing is Framing.LENGTH_PREFIXED)
    position = 1
    while position + 1 < len(data):
        pause, length = data[position : position + 2]
        sent = data[position + 2 : position + 2 + length]
        position += 2 + length
        now_ns += PAUSES_NS[pause % len(PAUSES_NS)]
        controller.take(sent)
        reference.transfer(sent, now_ns)
    servos = controller.servos
    assert {servo_id for servo_id, servo in servos.items() if servo.energised} == reference.energised
    assert {servo_id: servo.pulse_us for servo_id, servo in servos.items() if servo.pulse_us} == reference.pulses
    assert tuple(servos) == SERVO_IDS
    assert all(0 <= servo.angle_deg <= 180 for servo in servos.values())
    assert controller.executed == reference.executed
    assert (controller.dead is not None) == reference.dead
    assert len(controller.corruptions) <= 2 * 256
    return f"{framing}: {'some frames' if controller.executed else 'no frame'} executed"


PAUSES_NS: Final = (0, 1, 1_000_000, 400_000_000, 999_999_999, 1_000_000_000, 3_000_000_000)

TARGETS: Final[dict[str, Callable[[bytes], str]]] = {
    "intake": fuzz_intake,
    "decode": fuzz_decode,
    "simulator": fuzz_simulator,
}
