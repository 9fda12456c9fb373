"""From recorded frames to commands that make a gateway write them again. Pure.

What a command caused is sent as a command of the same frame. What the gateway decided by itself it decides again: it
repeats Stops, and stops silent legs. An emergency stop, and the Stops of a gateway that started or ended, are sent as
Stops of those legs. A recording that begins while servos run begins with Sets; these are sent as Starts.

Frames of several legs that one message caused are sent as one message again: nobody knows the order of several
messages that arrive in one instant.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from gateway.allowance import NS_PER_MS
from gateway.model.frames import Frame, FrameError, OneLeg, OneServo, Op, ServoOp, decode, servo_ids_of
from schemas import keys
from schemas.telemetry import Cause

_TOGETHER_NS: Final = 2 * NS_PER_MS
"""Six frames of one message are on the wire within a millisecond; two messages of a gait are 20 ms apart."""
APART_NS: Final = NS_PER_MS
"""Messages on different keys are sent at least so far apart, so that the gateway sees them in this order."""
MAX_PAUSE_NS: Final = 3600 * 1000 * NS_PER_MS
"""A step of the clock, forward or back, is a restart of the machine; nobody waits for an hour."""

SHOW_FRAMES: Final = 1000
"""A survey takes some 10 ms for so many."""

_OPS_OF: Final = slice(3, None, 4)
"""Where a frame's operations are: three, if it is for a leg."""
_SETS: Final = bytes([Op.SET] * 3)


class ReplayStep(NamedTuple):
    """One message to send, `at_ns` after the first, and the frames that it shall cause."""

    at_ns: int
    frames: tuple[Frame, ...]

    @property
    def key(self) -> str:
        """The key on which the message is sent."""
        first = self.frames[0]
        if len(self.frames) > 1:
            return keys.LEGS_COMMAND
        return keys.servo_command(first.servo_id) if isinstance(first, OneServo) else keys.leg_command(first.leg)

    def payload(self) -> dict[str, Any]:
        """The command that causes these frames."""
        first = self.frames[0]
        if isinstance(first, OneServo):
            return _servo(first.command)
        if len(self.frames) == 1:
            return _leg(first)
        return {"legs": {str(frame.leg): _leg(frame) for frame in self.frames if isinstance(frame, OneLeg)}}


@dataclass(slots=True)
class Plan:
    """What the frames of a recording come to, counted while they are read."""

    duration_ns: int = 0
    """From the first frame to the last."""
    legs: set[int] = field(default_factory=set)
    begun_running: int = 0
    """Servos whose first frame was a Set, which is sent as a Start."""
    longest_gap_ns: int = 0
    """Between two frames of a leg that runs."""
    left_out: int = 0
    """Frames that are incomplete, or none of this protocol, or come after the gateway's machine was started again."""


def survey(records: Iterable[Mapping[str, Any]], show: Callable[[Plan], object]) -> Plan:
    """What FrameRecords come to in their order; `show` is called now and then. Five times as quick as `steps_of`."""
    plan = Plan()
    legs = _Legs(plan)
    for count, (at_ns, _, data) in enumerate(_in_order(records, plan)):
        plan.duration_ns = at_ns
        if count % SHOW_FRAMES == 0:
            show(plan)
        if data[_OPS_OF] == _SETS and legs.set(data[2] // 10, at_ns):
            continue
        frame = _decoded(data)
        if frame is None:
            plan.left_out += 1
            continue
        plan.legs.add(frame.leg)
        legs.follow(frame, at_ns)
    return plan


def steps_of(records: Iterable[Mapping[str, Any]], *, watchdog_too: bool = False) -> Iterator[ReplayStep]:
    """The steps for FrameRecords in their order. `watchdog_too`: the watchdog's Stops are sent, too."""
    own = {Cause.REPEAT} if watchdog_too else {Cause.REPEAT, Cause.WATCHDOG}
    legs = _Legs(Plan())
    together: list[Frame] = []
    together_ns = 0
    before: ReplayStep | None = None
    for at_ns, cause, data in _in_order(records, Plan()):
        frame = _decoded(data)
        if frame is None:
            continue
        frame = legs.follow(frame, at_ns)
        if cause in own:
            continue
        if together and not (at_ns - together_ns <= _TOGETHER_NS and _one_message(together[-1], frame)):
            yield (before := _step(before, together_ns, together))
            together = []
        if not together:
            together_ns = at_ns
        together.append(frame)
    if together:
        yield _step(before, together_ns, together)


def _in_order(records: Iterable[Mapping[str, Any]], plan: Plan) -> Iterator[tuple[int, str, bytes]]:
    """When each frame was written after the first that a command caused, why, and its bytes."""
    begun_ns: int | None = None
    last_ns = 0
    over = False
    for record in records:
        if not _is_whole(record):
            plan.left_out += 1
            continue
        if begun_ns is None:
            if record["cause"] != Cause.COMMAND:  # the Stops of the gateway's start, or of what was before
                continue
            begun_ns = record["monotonic_ns"]
        at_ns = record["monotonic_ns"] - begun_ns
        over = over or not last_ns <= at_ns <= last_ns + MAX_PAUSE_NS
        try:
            data = bytes.fromhex(record["bytes"])
        except ValueError:
            data = b""
        if over or not data:
            plan.left_out += 1
            continue
        last_ns = at_ns
        yield at_ns, record["cause"], data


def _is_whole(record: Mapping[str, Any]) -> bool:
    """Whether it has what is needed of a FrameRecord: anybody's recording may have the channel."""
    at_ns = record.get("monotonic_ns")
    return isinstance(at_ns, int) and isinstance(record.get("bytes"), str) and isinstance(record.get("cause"), str)


def _decoded(data: bytes) -> Frame | None:
    try:
        return decode(data)
    except FrameError:
        return None


def _one_message(before: Frame, frame: Frame) -> bool:
    """Whether a LegsCommand can cause both, in this order: legs ascending, and Stops not mixed with the rest."""
    if not (isinstance(before, OneLeg) and isinstance(frame, OneLeg)):
        return False
    return before.leg < frame.leg and before.is_stop == frame.is_stop


def _step(before: ReplayStep | None, at_ns: int, frames: Sequence[Frame]) -> ReplayStep:
    step = ReplayStep(at_ns, tuple(frames))
    if before is not None and before.key != step.key:
        return step._replace(at_ns=max(at_ns, before.at_ns + APART_NS))
    return step


class _Legs:
    """Which servos run, as far as these frames tell."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._running: set[int] = set()
        self._moved_ns: dict[int, int] = {}
        self._all_run: set[int] = set()

    def set(self, leg: int, at_ns: int) -> bool:
        """Three Sets for a leg, if all its servos run: then there is nothing else to follow. Else False."""
        if leg not in self._all_run:
            return False
        self._plan.longest_gap_ns = max(self._plan.longest_gap_ns, at_ns - self._moved_ns[leg])
        self._moved_ns[leg] = at_ns
        return True

    def follow(self, frame: Frame, at_ns: int) -> Frame:
        """The frame, with a Start in place of a Set for a servo that does not run."""
        ops = [self._op(servo_id, command, at_ns) for servo_id, command in frame.servos]
        leg = frame.leg
        if not frame.is_stop:
            self._moved_ns[leg] = at_ns
        if self._running.issuperset(servo_ids_of(leg)):
            self._all_run.add(leg)
        else:
            self._all_run.discard(leg)
        if isinstance(frame, OneServo):
            return OneServo(frame.servo_id, ops[0])
        return OneLeg(frame.leg, (ops[0], ops[1], ops[2]))

    def _op(self, servo_id: int, command: ServoOp, at_ns: int) -> ServoOp:
        if command.op is Op.STOP:
            self._running.discard(servo_id)
            return command
        if servo_id in self._running:
            gap_ns = at_ns - self._moved_ns[servo_id // 10]
            self._plan.longest_gap_ns = max(self._plan.longest_gap_ns, gap_ns)
            return command
        self._running.add(servo_id)
        if command.op is Op.SET:
            self._plan.begun_running += 1
        return ServoOp(Op.START, command.angle_cdeg)


def _leg(frame: OneLeg) -> dict[str, Any]:
    return {"servos": [_servo(command) for command in frame.commands]}


def _servo(command: ServoOp) -> dict[str, Any]:
    if command.op is Op.STOP:
        return {"op": "stop"}
    return {"op": command.op.name.lower(), "angle_deg": command.angle_cdeg / 100}
