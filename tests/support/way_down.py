"""What a landing has to look like on the wire: for frames as a test has seen them, whoever told it of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

from gateway.model.frames import Frame, Op, decode
from schemas.telemetry import FrameRecord
from tests.hil.bed import Transfer

EARLY_MS = 20.0
"""The silent leg's last frame, from which the line is counted, is seen later than it was decided: on a busy machine by
so much, and all that follows seems too early by as much."""
MIDWAY = (0.25, 0.75)
"""Where a servo that goes to its angle has to be seen."""
SHORTEST_FRAME_BYTES = 6
"""Announcements and zeros are one byte."""


class Seen(NamedTuple):
    """A frame that was written, and when."""

    at_ms: float
    frame: Frame

    @property
    def leg(self) -> int:
        return self.frame.servos[0][0] // 10


def reported(records: Iterable[FrameRecord]) -> list[Seen]:
    """Frames as the gateway reports them."""
    return [Seen(each.monotonic_ns / 1e6, decode(bytes.fromhex(each.bytes))) for each in records]


def transferred(transfers: Iterable[Transfer]) -> list[Seen]:
    """Frames as the emulated device got them, in either framing."""
    return [
        Seen(each.monotonic_ns / 1e6, decode(each.data))
        for each in transfers
        if each.delivered and len(each.data) >= SHORTEST_FRAME_BYTES
    ]


@dataclass(frozen=True, slots=True)
class Way:
    """What was commanded up to a silence, and what the landing after it has to do."""

    stands_cdeg: Mapping[int, int]
    """Each servo that runs, and its angle."""
    pose_cdeg: Mapping[int, int]
    begins_ms: float
    arrives_ms: float
    """When each servo is where it goes, and two rate slots before the Stops."""

    @classmethod
    def after(
        cls,
        seen: Sequence[Seen],
        silent: int,
        pose: Mapping[int, float],
        *,
        timeout_ms: float,
        landing_ms: float,
        hz: float,
    ) -> Self:
        """`seen` ends with the silence of leg `silent`; `pose` in degrees; `hz` is the rate limit."""
        stands: dict[int, int] = {}
        for each in seen:
            for servo_id, op in each.frame.servos:
                if op.op is Op.STOP:
                    stands.pop(servo_id, None)
                else:
                    assert op.op is Op.START or servo_id in stands, f"{servo_id} was never started"
                    stands[servo_id] = op.angle_cdeg
        begins_ms = max(each.at_ms for each in seen if each.leg == silent) + timeout_ms
        pose_cdeg = {servo_id: round(100 * angle) for servo_id, angle in pose.items()}
        return cls(stands, pose_cdeg, begins_ms, begins_ms + landing_ms - 2000 / hz)

    def goes(self, servo_id: int) -> tuple[int, int]:
        """From where to where, in hundredths of a degree."""
        first = self.stands_cdeg[servo_id]
        return first, self.pose_cdeg.get(servo_id, first)

    def check(self, frames: Sequence[Seen], *, whole: bool = True) -> None:
        """A straight line for each servo that runs, and nothing for any other. `whole`: and to its end."""
        assert frames, "it goes nowhere"
        parts = dict.fromkeys(self.stands_cdeg, 0.0)
        midway: set[int] = set()
        said: dict[int, int] = dict(self.stands_cdeg)
        for at_ms, frame in frames:
            line = (at_ms + EARLY_MS - self.begins_ms) / (self.arrives_ms - self.begins_ms)
            least, most = 0.0, 1.0
            for servo_id, op in frame.servos:
                if op.op is Op.STOP:
                    assert servo_id not in self.stands_cdeg, f"{servo_id} is stopped before the end"
                    continue
                assert op.op is Op.SET, f"{servo_id} is started"
                assert servo_id in self.stands_cdeg, f"{servo_id} does not run"
                first, last = self.goes(servo_id)
                said[servo_id] = op.angle_cdeg
                if first == last:
                    assert op.angle_cdeg == first, f"{servo_id} holds its angle"
                    continue
                part = (op.angle_cdeg - first) / (last - first)
                rounded = 1 / abs(last - first)
                assert parts[servo_id] <= part <= min(1, line + rounded), f"{servo_id}: {part:.3f} at {line:.3f}"
                parts[servo_id] = part
                midway |= {servo_id} if MIDWAY[0] < part < MIDWAY[1] else set()
                least, most = max(least, part - rounded), min(most, part + rounded)
            assert least <= most, f"the leg leaves its straight line: {frame}"
        if whole:
            moved = {servo_id for servo_id in self.stands_cdeg if len({*self.goes(servo_id)}) > 1}
            assert midway == moved, "it is nowhere between its ends"
            assert said == {servo_id: self.goes(servo_id)[1] for servo_id in self.stands_cdeg}, (
                "the pose is not reached"
            )
