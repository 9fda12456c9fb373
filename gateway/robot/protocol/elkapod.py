"""The next frame and message of elkapod-2025, and the controller's signs of life. Pure, time as an argument.

Each frame has all eighteen angles, and a UART message starts or shuts down all servos. Only the order prevents motion
without a command: a shutdown precedes the first frame, and START_CYCLES frames with the commanded angles precede a
start. While all are shut down, frames repeat each servo's last commanded angle, so that a servo whose shutdown was lost
does not move.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Final

from gateway.model import elkapod
from gateway.model.elkapod import AnswerError, Measured
from gateway.model.frames import OP_START, OP_STOP, Frame
from gateway.rate_limit import NS_PER_MS
from schemas.robot import SERVO_IDS

START_CYCLES: Final = 2
"""Frames with a start's angles ahead of the UART's start, since the controller may still process an earlier frame."""
SILENT_NS: Final = 300 * NS_PER_MS
"""A controller is silent if no well-formed answer, or no heartbeat, comes for this long: 15 cycles, so that some may be
lost or late. The robot team's driver misses a heartbeat after 100 ms."""
FROZEN_NS: Final = 500 * NS_PER_MS
"""A controller is frozen if values that never rested stay equal for this long: a gyroscope's noise always changes."""
_BEATS: Final = 9
"""Heartbeats from which their period is computed: one that is a cycle late changes it by an eighth of a cycle."""
_POLL_NS: Final = SILENT_NS // 8
_GAP_NS: Final = SILENT_NS // 3


class Commanded:
    """The commanded state, and the next frame and UART message.

    If a power board powers each servo alone (`fed_singly`), its power starts and stops a servo. The UART starts the
    controller with the first servo, and shuts it down with the last.
    """

    def __init__(self, *, fed_singly: bool = False) -> None:
        self._fed_singly = fed_singly
        self._angles_cdeg = dict.fromkeys(SERVO_IDS, elkapod.MIDDLE_CDEG)
        self._frames = 0
        self._to_start: dict[int, int] = {}
        """Servos with a pending start, and how many frames had been made before."""
        self.ready: frozenset[int] = frozenset()
        """Servos that may be powered: their angles were on the wire, and then the UART sent start."""

    def shut_down(self) -> bytes:
        """Stop all servos, and drop waiting starts. Return the UART message to send."""
        self._to_start.clear()
        self.ready = frozenset()
        return elkapod.SHUTDOWN

    def stop(self, servo_ids: Collection[int]) -> bytes | None:
        """Stop these servos. Return the UART message to send, or None if others run and only the board stops these."""
        for servo_id in servo_ids:
            self._to_start.pop(servo_id, None)
        self.ready = self.ready.difference(servo_ids)
        return None if self._fed_singly and (self.ready or self._to_start) else self.shut_down()

    def take(self, frames: Sequence[Frame]) -> None:
        """Take frames that move: the next frame has their angles. Starts of all eighteen servos are one start."""
        for frame in frames:
            for servo_id, op in frame.servos:
                if op.op is OP_STOP:
                    continue  # a servo that does not run keeps its angle
                self._angles_cdeg[servo_id] = op.angle_cdeg
                if op.op is OP_START and not (self._fed_singly and servo_id in self.ready):
                    self._to_start[servo_id] = self._frames

    def prepare(self, to_feed: Mapping[int, int | None]) -> frozenset[int]:
        """Prepare servos for power. `to_feed` has the angle at which supply starts each (hundredths of a degree; None:
        it runs). Return those that may be powered now. Starts of servos that are not in `to_feed` are forgotten."""
        self.ready &= to_feed.keys()
        self._to_start = {each: since for each, since in self._to_start.items() if each in to_feed}
        for servo_id, angle_cdeg in to_feed.items():
            if angle_cdeg is not None and servo_id not in self.ready and servo_id not in self._to_start:
                self._angles_cdeg[servo_id] = angle_cdeg
                self._to_start[servo_id] = self._frames
        return self.ready

    def frame(self) -> bytes:
        """Return the next frame. Raises ValueError for illegal angles, a bug: the controller checks nothing."""
        self._frames += 1
        return elkapod.frame(tuple(self._angles_cdeg.values()))

    def left(self) -> bytes | None:
        """Record that the frame has left. Return the UART message that must follow at once, or None."""
        done = {each for each, since in self._to_start.items() if self._frames - since >= START_CYCLES}
        if not done or not (self._fed_singly or len(done) == len(SERVO_IDS)):
            return None
        for servo_id in done:
            del self._to_start[servo_id]
        self.ready |= done
        return elkapod.START


class Changes:
    """Which values of the answers change, and whether the answers are frozen.

    A missing sensor's values never change, and those of a battery or a foot may rest. So only values that have changed
    before, and never rested while the controller was alive, are evidence: a noisy sensor's.
    """

    def __init__(self) -> None:
        self._values: list[int] = []
        self._changed_ns: list[int] = []
        self._changed: set[int] = set()
        self._rested: set[int] = set()

    def note(self, answer: bytes, now_ns: int) -> bool:
        """Take a well-formed answer. Return whether it is a measurement; False: the controller is frozen."""
        frozen = not self._changed <= self._rested and now_ns - max(self._changed_ns) >= FROZEN_NS
        before, self._values = self._values, memoryview(answer[elkapod.VALUES]).cast("I").tolist()
        if self._values == before:
            return not frozen
        self._changed_ns = self._changed_ns or [now_ns] * len(self._values)
        for place, changed in enumerate(now != then for now, then in zip(self._values, before, strict=False)):
            if now_ns - self._changed_ns[place] >= FROZEN_NS and not (changed and frozen):
                self._rested.add(place)
            if changed:
                self._changed.add(place)
                self._changed_ns[place] = now_ns
        return True


class SignsOfLife:
    """Whether the controller is alive: it has to send both answers and heartbeats, from `begun_ns` on.

    Also whether it may have restarted: after good ones, an answer was malformed or two heartbeats are missing. A
    heartbeat waits in the kernel, so a late poll still finds it; only if the whole machine was suspended it may be
    lost. So a poll counts for _POLL_NS at most, and a gap below _GAP_NS does not count, since a busy machine may delay
    heartbeats for this long.
    """

    def __init__(self, begun_ns: int) -> None:
        self._begun_ns = begun_ns
        self._rest = b""
        self._polled_ns = begun_ns
        self._quiet_ns = 0
        self._beats_ns: deque[int] = deque(maxlen=_BEATS)
        self._beat_ns: int | None = None
        """When the last heartbeat was found; `_beats_ns`: the last few."""
        self._changes = Changes()
        self._why = "none has come"
        self.answered_ns: int | None = None
        """When the last well-formed answer was received."""
        self.restarted = ""
        """Why the controller counts as restarted, or "". Then continue with `anew`."""

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take the bytes that the UART has received since the last call."""
        count, self._rest = elkapod.heartbeats(self._rest + data)
        since_ns, self._polled_ns = now_ns - self._polled_ns, now_ns
        beats_ns = self._beats_ns
        self._quiet_ns += min(since_ns, _POLL_NS)
        if len(beats_ns) == _BEATS:
            two_and_a_half_ns = 5 * (beats_ns[-1] - beats_ns[0]) // (2 * (_BEATS - 1))
            if self._quiet_ns >= max(two_and_a_half_ns, _GAP_NS):
                self.restarted = "two of its heartbeats are missing"
        if not count:
            return
        self._quiet_ns, self._beat_ns = 0, now_ns
        if since_ns > _POLL_NS:  # their times are not known
            beats_ns.clear()
            count = 1
        beats_ns.extend([now_ns] * count)

    def answered(self, data: bytes, now_ns: int) -> Measured | None:
        """Take an answer. Return its values, or None if it is malformed or frozen."""
        try:
            found = elkapod.measured(data)
        except AnswerError as error:
            self._why = str(error)
            if self.answered_ns is not None:
                self.restarted = f"after well-formed answers, one is malformed: {error}"
            return None
        if not self._changes.note(data, now_ns):
            self._why = f"it has not changed for {FROZEN_NS // NS_PER_MS} ms"
            return None
        self.answered_ns = now_ns
        return found

    def anew(self) -> "SignsOfLife":
        """Return the signs of the restarted controller, due at the times of the present ones."""
        newest = [ns for ns in (self.answered_ns, self._beat_ns) if ns is not None]
        return SignsOfLife(min(newest, default=self._begun_ns))

    def alive(self, now_ns: int) -> bool:
        """Return whether answers and heartbeats were received and neither is overdue."""
        return self.answered_ns is not None and self._beat_ns is not None and self.silent(now_ns) is None

    def silent(self, now_ns: int) -> str | None:
        """Return a sentence that names what has been missing for too long, or None."""
        for sign, newest_ns, why in (
            ("well-formed answer", self.answered_ns, f" (the last one: {self._why})"),
            ("heartbeat", self._beat_ns, ""),
        ):
            if now_ns - (self._begun_ns if newest_ns is None else newest_ns) >= SILENT_NS:
                return f"no {sign} of the controller for {SILENT_NS // NS_PER_MS} ms{why}"
        return None
