"""What becomes of commands: counted, recorded, answered, and told where they are rejected."""

import itertools
from collections.abc import Callable, Sequence

from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.events import Completed, Transmit
from gateway.robot.core.intake import echo_of
from gateway.robot.core.message import Reply
from gateway.robot.runtime.metrics import Metrics
from gateway.robot.runtime.sources import Sources, Tell
from schemas.telemetry import Ack, Kind, Reason

Servos = Sequence[tuple[int, object]]
"""The servos that a command names, each with what it asks of it."""
Sender = tuple[str, str | None, Reply | None, Servos]
"""Of a command that the supervisor knows by its number: its key, its source, how it is answered, and for what."""


class Answers:
    """Knows who waits for which answer. Called by the owner of the state."""

    def __init__(
        self, metrics: Metrics, recorder: Recorder, sources: Sources, tell: Tell, clock: Callable[[], int]
    ) -> None:
        self.pending: dict[int, Sender] = {}
        """The commands whose end the supervisor has not told yet, by their numbers."""
        self.numbers = itertools.count(1)
        self.rejected = 0
        """The number of the last command that the supervisor rejected."""
        self._written: dict[int, list[int]] = {}
        """The legs that a command under way has had a frame written for."""
        self._metrics = metrics
        self._recorder = recorder
        self._sources = sources
        self._tell = tell
        self._clock = clock

    def expect(self, key: str, source: str | None, reply: Reply | None, servos: Servos) -> int:
        """The number of a new command, which is answered under it."""
        number = next(self.numbers)
        self.pending[number] = key, source, reply, servos
        return number

    def wrote(self, transmit: Transmit) -> None:
        """A frame was written: should a command that it belongs to be rejected now, its answer names the leg."""
        for number in transmit.numbers:
            self._written.setdefault(number, []).append(transmit.frame.leg)

    def accept(self, completed: Completed) -> None:
        """A command has taken effect."""
        self._metrics.accepted += 1
        self._metrics.coalesced += completed.coalesced
        key, source, reply, _ = self.pending.pop(completed.number)
        self._written.pop(completed.number, None)
        self._recorder.decided(completed.number, "coalesced" if completed.coalesced else "accepted", key, source)
        if reply is not None:
            reply(Ack(accepted=True, coalesced=True if completed.coalesced else None).model_dump_json().encode())

    def reject_pending(self, number: int, reason: Reason, detail: str) -> None:
        """A command that the supervisor knows takes no effect, or none beyond the frames that were written of it."""
        self.rejected = number
        key, source, reply, servos = self.pending.pop(number)
        written = sorted(set(self._written.pop(number, ())))
        self.reject(key, source, reply, reason, detail, number, servos, written)

    def reject_unread(self, key: str, source: str | None, detail: str, reason: Reason = Reason.INVALID) -> None:
        """Tell of a message that is rejected without being taken: on a key that nothing reads, or about the lease."""
        self.reject(echo_of(key), source, None, reason, detail)

    def reject(
        self,
        key: str,
        source: str | None,
        reply: Reply | None,
        reason: Reason,
        detail: str,
        number: int = 0,
        servos: Servos = (),
        written: Sequence[int] = (),
    ) -> None:
        """A message takes no effect; without a number it gets no further than this.

        `servos`: where it was read; `written`: the legs for which a frame of it was written.
        """
        if written:
            legs = f"leg{'s' if len(written) > 1 else ''} {', '.join(map(str, written))}"
            detail = f"{detail}; what it asks of {legs} had been written before"
        self._metrics.rejected[reason] += 1
        self._recorder.decided(number, reason, key, source)
        if reply is not None:
            ack = Ack(accepted=False, reason=reason, detail=detail, written=list(written) or None)
            reply(ack.model_dump_json().encode())
        left_out = self._sources.admit(Kind.COMMAND_REJECTED, source, self._clock())
        if left_out is not None:
            self._tell(Kind.COMMAND_REJECTED, detail, source, key, reason, left_out, legs_of(servos))


def legs_of(servos: Servos) -> tuple[int, ...]:
    """Whose servos these are, ascending."""
    return tuple(sorted({servo_id // 10 for servo_id, _ in servos}))
