"""The next frame and message of elkapod-2025, and the controller's signs of life. Pure, time as an argument.

Each frame has all eighteen angles, and a UART message starts or shuts down all servos. Only the order prevents motion
without a command: a shutdown precedes the first frame, and START_CYCLES frames with the commanded angles precede a
start. While all are shut down, frames repeat each servo's last commanded angle, so that a servo whose shutdown was lost
does not move.
"""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model import elkapod
from gateway.model.elkapod import AnswerError, Heartbeats, Measured
from gateway.model.frames import OP_START, OP_STOP, Frame
from schemas.robot import SERVO_IDS

START_CYCLES: Final = 2
"""Frames with a start's angles ahead of the UART's start, since the controller may still process an earlier frame."""
FROZEN_NS: Final = 500 * NS_PER_MS
"""A controller is frozen if values that never rested stay equal for this long: a gyroscope's noise always changes."""
_BEATS: Final = 9
"""Heartbeats from which their period is computed: one that is a cycle late changes it by an eighth of a cycle."""
_PLACES: Final = {servo_id: place for place, servo_id in enumerate(SERVO_IDS)}


class Commanded:
    """The commanded state, and the next frame and UART message.

    If a power board powers each servo alone (`fed_singly`), its power starts and stops a servo. The UART starts the
    controller with the first servo, and shuts it down with the last.
    """

    def __init__(self, *, fed_singly: bool = False) -> None:
        self._fed_singly = fed_singly
        self._angles_cdeg = [elkapod.MIDDLE_CDEG] * len(SERVO_IDS)
        self._to_start: dict[int, int] = {}
        """Servos with a pending start, and how many frames with its angle have left."""
        self._carried: set[int] = set()
        """Those of them whose angle is in the latest frame."""
        self.ready: frozenset[int] = frozenset()
        """Servos that may be powered: their angles were on the wire, and then the UART sent start."""

    def shut_down(self) -> bytes:
        """Stop all servos, and drop waiting starts. Return the UART message to send."""
        self._to_start.clear()
        self._carried.clear()
        self.ready = frozenset()
        return elkapod.SHUTDOWN

    def stop(self, servo_ids: Collection[int]) -> bytes | None:
        """Stop these servos. Return the UART message to send, or None if others run and only the board stops these."""
        for servo_id in servo_ids:
            self._to_start.pop(servo_id, None)
        self._carried.difference_update(servo_ids)
        self.ready = self.ready.difference(servo_ids)
        return None if self._fed_singly and (self.ready or self._to_start) else self.shut_down()

    def take(self, frames: Sequence[Frame]) -> None:
        """Take frames that move: the next frame has their angles. Starts of all eighteen servos are one start."""
        for frame in frames:
            for servo_id, op in frame.servos:
                if op.op is OP_STOP:
                    continue  # a servo that does not run keeps its angle
                self._angles_cdeg[_PLACES[servo_id]] = op.angle_cdeg
                if op.op is OP_START and not (self._fed_singly and servo_id in self.ready):
                    self._to_start[servo_id] = 0
                    self._carried.discard(servo_id)

    def prepare(self, to_feed: Mapping[int, int | None]) -> frozenset[int]:
        """Prepare servos for power. `to_feed` has the angle at which supply starts each (hundredths of a degree; None:
        it runs). Return those that may be powered now. Starts of servos that are not in `to_feed` are forgotten."""
        self.ready &= to_feed.keys()
        for servo_id in self._to_start.keys() - to_feed.keys():
            del self._to_start[servo_id]
        self._carried &= self._to_start.keys()
        for servo_id, angle_cdeg in to_feed.items():
            if angle_cdeg is not None and servo_id not in self.ready and servo_id not in self._to_start:
                self._angles_cdeg[_PLACES[servo_id]] = angle_cdeg
                self._to_start[servo_id] = 0
        return self.ready

    def frame(self) -> bytes:
        whole = self._fed_singly or len(self._to_start) == len(SERVO_IDS)
        self._carried = set(self._to_start) if whole else set()
        return elkapod.frame(self._angles_cdeg)

    def left(self) -> bytes | None:
        """Record that the frame has left. Return the UART message that must follow at once, or None."""
        for servo_id in self._carried:
            self._to_start[servo_id] += 1
        done = {servo_id for servo_id in self._carried if self._to_start[servo_id] >= START_CYCLES}
        self._carried.clear()
        if not done:
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

    def __init__(self, begun_ns: int) -> None:
        self._answer = b""
        self._values: tuple[float, ...] = ()
        self._changed_ns = [begun_ns] * elkapod.VALUES
        self._newest_ns = begun_ns
        self._changed: set[int] = set()
        self._rested: set[int] = set()

    def note(self, answer: bytes, now_ns: int) -> bool:
        """Take a well-formed answer. Return whether it is a measurement; False: the controller is frozen."""
        witnesses = self._changed - self._rested
        frozen = bool(witnesses) and now_ns - self._newest_ns >= FROZEN_NS
        if answer == self._answer:
            return not frozen
        before, self._values, self._answer = self._values, elkapod.values_of(answer), answer
        for place, value in enumerate(self._values):
            changed = bool(before) and value != before[place]
            if before and now_ns - self._changed_ns[place] >= FROZEN_NS and not (changed and frozen):
                self._rested.add(place)
            if changed:
                self._changed.add(place)
            if changed or not before:
                self._changed_ns[place] = now_ns
        self._newest_ns = now_ns
        return True


class Beats:
    """Heartbeats, and whether two in a row are missing.

    A heartbeat waits in the kernel, so a late poll still finds it; only if the whole machine was suspended it may be
    lost. So a poll counts for an eighth of `silent_ns` at most, and a gap below a third of `silent_ns` does not count,
    since a busy machine may delay heartbeats for this long.
    """

    def __init__(self, silent_ns: int, begun_ns: int) -> None:
        self._least_ns, self._poll_ns = silent_ns // 3, silent_ns // 8
        self._heartbeats = Heartbeats()
        self._polled_ns = begun_ns
        self._came_ns: deque[int] = deque(maxlen=_BEATS)
        self._quiet_ns = 0
        self.missing = False
        """Whether none was received for two and a half of their periods, once the period is known."""

    @property
    def newest_ns(self) -> int | None:
        """When the newest heartbeat was found (ns); None: none was."""
        return self._came_ns[-1] if self._came_ns else None

    def take(self, data: bytes, now_ns: int) -> None:
        """Take the bytes that the UART has received since the last call."""
        count, since_ns = self._heartbeats.feed(data), now_ns - self._polled_ns
        self._polled_ns = now_ns
        self._quiet_ns += min(since_ns, self._poll_ns)
        if len(self._came_ns) == _BEATS:
            two_and_a_half_ns = 5 * (self._came_ns[-1] - self._came_ns[0]) // (2 * (_BEATS - 1))
            self.missing = self._quiet_ns >= max(two_and_a_half_ns, self._least_ns)
        if not count:
            return
        self._quiet_ns = 0
        if since_ns > self._poll_ns:  # their times are not known
            self._came_ns.clear()
            count = 1
        self._came_ns.extend([now_ns] * count)


class SignsOfLife:
    """Whether the controller is alive: it has to send both answers and heartbeats, from `begun_ns` on.

    Also whether it may have restarted: after good ones, an answer was malformed or two heartbeats are missing.
    """

    def __init__(self, silent_ns: int, begun_ns: int) -> None:
        self._silent_ns = silent_ns
        self._begun_ns = begun_ns
        self._beats = Beats(silent_ns, begun_ns)
        self.changes = Changes(begun_ns)
        self._why = "none has come"
        self.answered_ns: int | None = None
        """When the last well-formed answer was received."""
        self.restarted = ""
        """Why the controller counts as restarted, or "". Then continue with `anew`."""

    def receive(self, data: bytes, now_ns: int) -> None:
        self._beats.take(data, now_ns)
        if self._beats.missing:
            self.restarted = "two of its heartbeats are missing"

    def answered(self, data: bytes, now_ns: int) -> Measured | None:
        """Take an answer. Return its values, or None if it is malformed or frozen."""
        try:
            found = elkapod.measured(data)
        except AnswerError as error:
            self._why = str(error)
            if self.answered_ns is not None:
                self.restarted = f"after well-formed answers, one is malformed: {error}"
            return None
        if not self.changes.note(data, now_ns):
            self._why = f"it has not changed for {FROZEN_NS // NS_PER_MS} ms"
            return None
        self.answered_ns = now_ns
        return found

    def anew(self) -> "SignsOfLife":
        """Return the signs of the restarted controller, due at the times of the present ones."""
        newest = [ns for ns in (self.answered_ns, self._beats.newest_ns) if ns is not None]
        return SignsOfLife(self._silent_ns, min(newest, default=self._begun_ns))

    def alive(self, now_ns: int) -> bool:
        """Return whether answers and heartbeats were received and neither is overdue."""
        return self.answered_ns is not None and self._beats.newest_ns is not None and self.silent(now_ns) is None

    def silent(self, now_ns: int) -> str | None:
        """Return a sentence that names what has been missing for too long, or None."""
        silent_ms = self._silent_ns // NS_PER_MS
        if now_ns - (self._begun_ns if self.answered_ns is None else self.answered_ns) >= self._silent_ns:
            return f"no well-formed answer of the controller for {silent_ms} ms (the last one: {self._why})"
        beat_ns = self._beats.newest_ns
        if now_ns - (self._begun_ns if beat_ns is None else beat_ns) >= self._silent_ns:
            return f"no heartbeat of the controller for {silent_ms} ms"
        return None
