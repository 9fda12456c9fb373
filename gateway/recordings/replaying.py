"""From recorded frames to commands that make a gateway write them again, and whether it did. Pure.

What a command caused is sent as a command of the same frame. What the gateway decided by itself it decides again: it
repeats Stops, and stops silent legs. An emergency stop, and the Stops of a gateway that started or ended, are sent as
Stops of those legs. A recording that begins while servos run begins with Sets; these are sent as Starts.

Frames of several legs that one message caused are sent as one message again: nobody knows the order of several
messages that arrive in one instant.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Final, NamedTuple

from gateway.protocol.frames import Frame, FrameError, OneLeg, OneServo, Op, ServoOp, decode
from schemas import keys
from schemas.robot import LEGS
from schemas.telemetry import Cause

NS_PER_MS: Final = 1_000_000
TOGETHER_NS: Final = 2 * NS_PER_MS
"""Six frames of one message are on the wire within a millisecond; two messages of a gait are 20 ms apart."""
APART_NS: Final = NS_PER_MS
"""Messages on different keys are sent at least so far apart, so that the gateway sees them in this order."""
NO_STEP: Final = -1
MAX_PAUSE_NS: Final = 3600 * 1000 * NS_PER_MS
"""A step of the clock, forward or back, is a restart of the machine; nobody waits for an hour."""

_OPS: Final = {Op.START: "start", Op.SET: "set", Op.STOP: "stop"}


class Written(NamedTuple):
    """A frame on the wire: when, by the gateway's monotonic clock, and whether a command caused it."""

    at_ns: int
    data: bytes
    commanded: bool = True
    step: int = NO_STEP
    """Of an expected frame: the place of the step that causes it. What the gateway does by itself follows from the last
    step of that leg: so long after it comes the watchdog's Stop, or a Stop's repeat."""


class Step(NamedTuple):
    """One message to send, `at_ns` after the first, and the frames that it shall cause."""

    at_ns: int
    frames: tuple[Frame, ...]
    recorded_ns: int
    """When the first of the frames was written; `at_ns` is later where messages must be kept apart."""

    @property
    def key(self) -> str:
        """Where to send it."""
        first = self.frames[0]
        if len(self.frames) > 1:
            return keys.LEGS_COMMAND
        return keys.servo_command(first.servo_id) if isinstance(first, OneServo) else keys.leg_command(first.leg)

    def payload(self) -> dict[str, Any]:
        """What to send."""
        first = self.frames[0]
        if isinstance(first, OneServo):
            return _servo(first.command)
        if len(self.frames) == 1:
            return _leg(first)
        return {"legs": {str(frame.leg): _leg(frame) for frame in self.frames if isinstance(frame, OneLeg)}}


@dataclass(slots=True)
class Plan:
    """What to send, and what the gateway then writes."""

    steps: list[Step] = field(default_factory=list)
    expected: list[Written] = field(default_factory=list)
    begun_running: int = 0
    """Servos whose first frame was a Set, which is sent as a Start."""
    longest_gap_ns: int = 0
    """Between two frames of a leg that runs."""
    left_out: int = 0
    """Frames that are incomplete, or none of this protocol, or come after the gateway's machine was started again."""

    @property
    def duration_ns(self) -> int:
        """From the first step to the last."""
        return self.steps[-1].at_ns if self.steps else 0


def plan(records: Iterable[Mapping[str, Any]], *, watchdog_too: bool = False) -> Plan:
    """The plan for FrameRecords in their order. `watchdog_too`: the watchdog's Stops are sent, too."""
    own = {Cause.REPEAT} if watchdog_too else {Cause.REPEAT, Cause.WATCHDOG}
    found, legs = Plan(), _Legs()
    begun_ns: int | None = None
    last_ns = 0
    over = False
    together: list[Frame] = []
    together_ns = 0
    steps: dict[int, int] = {}  # of each leg the last one
    for record in records:
        if not _is_whole(record):
            found.left_out += 1
            continue
        if begun_ns is None:
            if record["cause"] != Cause.COMMAND:  # the Stops of the gateway's start, or of what was before
                continue
            begun_ns = record["monotonic_ns"]
        at_ns = record["monotonic_ns"] - begun_ns
        over = over or not last_ns <= at_ns <= last_ns + MAX_PAUSE_NS
        frame = _decoded(record["bytes"])
        if frame is None or over:
            found.left_out += 1
            continue
        last_ns = at_ns
        frame = legs.follow(frame, at_ns)
        leg = frame.servos[0][0] // 10
        if record["cause"] in own:
            found.expected.append(Written(at_ns, frame.to_bytes(), commanded=False, step=steps.get(leg, NO_STEP)))
            continue
        if together and not (at_ns - together_ns <= TOGETHER_NS and _one_message(together[-1], frame)):
            _add(found.steps, together_ns, together)
            together = []
        if not together:
            together_ns = at_ns
        together.append(frame)
        steps[leg] = len(found.steps)
        found.expected.append(Written(at_ns, frame.to_bytes(), step=steps[leg]))
    if together:
        _add(found.steps, together_ns, together)
    found.begun_running, found.longest_gap_ns = legs.begun_running, legs.longest_gap_ns
    return found


def _is_whole(record: Mapping[str, Any]) -> bool:
    """Whether it has what is needed of a FrameRecord: anybody's recording may have the channel."""
    at_ns = record.get("monotonic_ns")
    return isinstance(at_ns, int) and isinstance(record.get("bytes"), str) and isinstance(record.get("cause"), str)


def _decoded(hex_bytes: str) -> Frame | None:
    try:
        return decode(bytes.fromhex(hex_bytes))
    except (FrameError, ValueError):
        return None


def _one_message(before: Frame, frame: Frame) -> bool:
    """Whether a LegsCommand can cause both, in this order: legs ascending, and Stops not mixed with the rest."""
    if not (isinstance(before, OneLeg) and isinstance(frame, OneLeg)):
        return False
    return before.leg < frame.leg and before.is_stop == frame.is_stop


def _add(steps: list[Step], at_ns: int, frames: Sequence[Frame]) -> None:
    step = Step(at_ns, tuple(frames), at_ns)
    if steps and steps[-1].key != step.key:
        step = step._replace(at_ns=max(at_ns, steps[-1].at_ns + APART_NS))
    steps.append(step)


class _Legs:
    """Which servos run, as far as these frames tell."""

    def __init__(self) -> None:
        self._running: set[int] = set()
        self._moved_ns: dict[int, int] = {}
        self.begun_running = 0
        self.longest_gap_ns = 0

    def follow(self, frame: Frame, at_ns: int) -> Frame:
        """The frame, with a Start in place of a Set for a servo that does not run."""
        ops = [self._op(servo_id, command, at_ns) for servo_id, command in frame.servos]
        if not frame.is_stop:
            self._moved_ns[frame.servos[0][0] // 10] = at_ns
        if isinstance(frame, OneServo):
            return OneServo(frame.servo_id, ops[0])
        return OneLeg(frame.leg, (ops[0], ops[1], ops[2]))

    def _op(self, servo_id: int, command: ServoOp, at_ns: int) -> ServoOp:
        if command.op is Op.STOP:
            self._running.discard(servo_id)
            return command
        if servo_id in self._running:
            self.longest_gap_ns = max(self.longest_gap_ns, at_ns - self._moved_ns[servo_id // 10])
            return command
        self._running.add(servo_id)
        if command.op is Op.SET:
            self.begun_running += 1
        return ServoOp(Op.START, command.angle_cdeg)


def _leg(frame: OneLeg) -> dict[str, Any]:
    return {"servos": [_servo(command) for command in frame.commands]}


def _servo(command: ServoOp) -> dict[str, Any]:
    if command.op is Op.STOP:
        return {"op": "stop"}
    return {"op": _OPS[command.op], "angle_deg": command.angle_cdeg / 100}


# ---- did it write the same?


class Sent(NamedTuple):
    """When a step was handed to Zenoh: not before the one time and not after the other. On the plan's clock."""

    begun_ns: int
    done_ns: int


class Comparison(NamedTuple):
    """What a gateway wrote beside what it was expected to write."""

    frames: int
    """Expected."""
    differences: list[str]
    """A sentence for each leg whose frames are not the same bytes in the same order."""
    swapped: int
    """Commands' frames that another leg's frame overtook. The gateway's own are as punctual as its timers."""
    worst_ms: float
    p99_ms: float
    """How far frames are from their time, the way from here to the wire being that of most frames.

    A frame's time is counted from when its command was sent. So a sender that is late is not taken for a late gateway.
    """
    worst_at_s: float
    """When the frame that is farthest from its time was written in the recording."""
    beyond: int
    """Frames that are farther than the tolerance."""

    @property
    def passes(self) -> bool:
        """Same bytes, same order, times within the tolerance."""
        return not self.differences and self.swapped == 0 and self.beyond == 0


def compare(plan: Plan, sent: Sequence[Sent], written: Sequence[Written], tolerance_ms: float) -> Comparison:
    """Leg by leg, what commands caused and what the gateway did by itself; then the order of the commands' frames."""
    expected = plan.expected
    wanted, found = _sorted_out(expected), _sorted_out(written)
    differences: list[str] = []
    pairs: list[tuple[int, int]] = []
    for kind in wanted:
        same = 0
        for want, have in zip(wanted[kind], found[kind], strict=False):
            if expected[want].data != written[have].data:
                break
            same += 1
        pairs += zip(wanted[kind][:same], found[kind][:same], strict=True)
        if same < max(len(wanted[kind]), len(found[kind])):
            missing, extra = (
                [frames[place] for place in places[kind][same:]]
                for frames, places in ((expected, wanted), (written, found))
            )
            differences.append(_difference(kind, same, missing, extra))
    pairs.sort()
    newest, swapped = -1, 0
    for want, have in pairs:
        if expected[want].commanded:
            swapped += have < newest
            newest = max(newest, have)
    took = [_took(plan, sent, expected[want], written[have]) for want, have in pairs]
    usual_ns = median(least_ns for least_ns, _ in took) if took else 0
    away = sorted(
        (max(0, least_ns - usual_ns, usual_ns - most_ns) / NS_PER_MS, expected[want].at_ns / 1e9)
        for (least_ns, most_ns), (want, _) in zip(took, pairs, strict=True)
    ) or [(0.0, 0.0)]
    (worst_ms, worst_at_s), (p99_ms, _) = away[-1], away[len(away) * 99 // 100]
    beyond = sum(away_ms > tolerance_ms for away_ms, _ in away)
    return Comparison(len(expected), differences, swapped, worst_ms, p99_ms, worst_at_s, beyond)


def _took(plan: Plan, sent: Sequence[Sent], expected: Written, written: Written) -> tuple[int, int]:
    """How much longer than in the recording it took from here to the wire, at least and at most, but for a constant."""
    after_ns = written.at_ns - expected.at_ns
    if not 0 <= expected.step < len(sent):
        return after_ns, after_ns
    recorded_ns, step = plan.steps[expected.step].recorded_ns, sent[expected.step]
    return after_ns - (step.done_ns - recorded_ns), after_ns - (step.begun_ns - recorded_ns)


_OfLeg = tuple[int, bool]
"""A leg, and whether commands caused it."""


def _sorted_out(frames: Sequence[Written]) -> dict[_OfLeg, list[int]]:
    """The places of each leg's frames; a frame's third byte is the id of its first servo."""
    found: dict[_OfLeg, list[int]] = {(leg, commanded): [] for leg in LEGS for commanded in (True, False)}
    for place, frame in enumerate(frames):
        found[frame.data[2] // 10, frame.commanded].append(place)
    return found


def _difference(kind: _OfLeg, same: int, missing: Sequence[Written], extra: Sequence[Written]) -> str:
    leg, commanded = kind
    where = f"leg {leg}{'' if commanded else ', of its own'}: {same} frames are the same"
    if not missing:
        return f"{where}; then {extra[0].data.hex()} was written, and {len(extra)} frames are too many"
    at_s = missing[0].at_ns / 1e9
    if not extra:
        return f"{where}; {len(missing)} are missing, the first at {at_s:.3f} s: {missing[0].data.hex()}"
    return f"{where}; at {at_s:.3f} s {extra[0].data.hex()} was written in place of {missing[0].data.hex()}"
