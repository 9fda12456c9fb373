"""What elkapod-2025 says next, and whether the controller is alive: pure, time as an argument.

All eighteen angles stand in each frame, and a UART message starts or shuts down all servos. So the order is what keeps
servos from moving unasked: a shutdown comes before the first frame, and a start only behind START_CYCLES frames with
the angles that were commanded. While all are shut down, frames go on with each servo's last commanded angle, since one
whose shutdown was lost must not move for it.
"""

from collections.abc import Collection, Sequence
from typing import Final

from gateway.allowance import NS_PER_MS
from gateway.model import elkapod
from gateway.model.elkapod import AnswerError, Heartbeats, Measured
from gateway.model.frames import OP_START, Frame
from schemas.robot import SERVO_IDS

START_CYCLES: Final = 2
"""Frames with a start's angles ahead of the UART's start: the controller may still work on the one before."""
FROZEN_NS: Final = 500 * NS_PER_MS
"""An answer that stays the same to the last bit for so long is no measurement: a gyroscope's noise changes it."""
_PLACES: Final = {servo_id: place for place, servo_id in enumerate(SERVO_IDS)}


class Commanded:
    """What the robot was told, and the next frame and UART message.

    Where a power board feeds each servo by itself (`fed_singly`), that is a servo's start and its Stop. The UART starts
    the controller with the first of them, and shuts it down with the last.
    """

    def __init__(self, *, fed_singly: bool = False) -> None:
        self._fed_singly = fed_singly
        self._angles_cdeg = [elkapod.MIDDLE_CDEG] * len(SERVO_IDS)
        self._to_start: dict[int, int] = {}
        """Servos with a start that is not carried out yet, and how many frames with its angle have left."""
        self._carried: set[int] = set()
        """Those whose start's angle is in the frame that `frame` made last."""
        self.ready: frozenset[int] = frozenset()
        """Servos that may be fed: their angles were on the wire, and then the UART said start."""

    def shut_down(self) -> bytes:
        """A Stop of all: the message that shuts down all servos. No start that waits comes after it."""
        self._to_start.clear()
        self._carried.clear()
        self.ready = frozenset()
        return elkapod.SHUTDOWN

    def stop(self, servo_ids: Collection[int]) -> bytes | None:
        """A Stop of these. Returns the UART's message for it; None: others run, so only the board stops these."""
        for servo_id in servo_ids:
            self._to_start.pop(servo_id, None)
        self._carried.difference_update(servo_ids)
        self.ready = self.ready.difference(servo_ids)
        return None if self._fed_singly and (self.ready or self._to_start) else self.shut_down()

    def take(self, frames: Sequence[Frame]) -> None:
        """Take frames that move: their angles are in the next frame, and starts of all eighteen servos are a start."""
        for frame in frames:
            for servo_id, op in frame.servos:
                self._angles_cdeg[_PLACES[servo_id]] = op.angle_cdeg
                if op.op is OP_START:
                    self._to_start[servo_id] = 0
                    self._carried.discard(servo_id)

    def frame(self) -> bytes:
        """The next frame."""
        whole = self._fed_singly or len(self._to_start) == len(SERVO_IDS)
        self._carried = set(self._to_start) if whole else set()
        return elkapod.frame(self._angles_cdeg)

    def left(self) -> bytes | None:
        """The frame has left. Returns the UART message that is to follow it at once, if one is."""
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


class SignsOfLife:
    """Whether the controller is alive: both its answers and its heartbeats have to come, from `begun_ns` on."""

    def __init__(self, silent_ns: int, begun_ns: int) -> None:
        self._silent_ns = silent_ns
        self._begun_ns = begun_ns
        self._heartbeats = Heartbeats()
        self._heartbeat_ns: int | None = None
        self._answer, self._changed_ns = b"", begun_ns
        self._why = "none has come"
        self.answered_ns: int | None = None
        """When the last well-formed answer came."""

    def heard(self, data: bytes, now_ns: int) -> None:
        """Take what the UART has received."""
        if self._heartbeats.feed(data):
            self._heartbeat_ns = now_ns

    def answered(self, data: bytes, now_ns: int) -> Measured | None:
        """Take an answer; None: it counts as none."""
        try:
            found = elkapod.measured(data)
        except AnswerError as error:
            self._why = str(error)
            return None
        if data != self._answer:
            self._answer, self._changed_ns = data, now_ns
        elif now_ns - self._changed_ns >= FROZEN_NS:
            self._why = f"it has not changed for {FROZEN_NS // NS_PER_MS} ms"
            return None
        self.answered_ns = now_ns
        return found

    def alive(self, now_ns: int) -> bool:
        """Whether both have come, and go on."""
        return self.answered_ns is not None and self._heartbeat_ns is not None and self.silent(now_ns) is None

    def silent(self, now_ns: int) -> str | None:
        """A sentence that says what has not come for too long; None: it is alive."""
        silent_ms = self._silent_ns // NS_PER_MS
        if now_ns - (self._begun_ns if self.answered_ns is None else self.answered_ns) >= self._silent_ns:
            return f"no well-formed answer of the controller for {silent_ms} ms (the last one: {self._why})"
        if now_ns - (self._begun_ns if self._heartbeat_ns is None else self._heartbeat_ns) >= self._silent_ns:
            return f"no heartbeat of the controller for {silent_ms} ms"
        return None
