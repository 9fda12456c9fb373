"""What becomes of commands: counted, recorded, answered, and published where they are rejected."""

from collections.abc import Sequence
from dataclasses import dataclass

from gateway.errors import SpiError
from gateway.robot.blackbox.recorder import ACCEPTED, COALESCED, Decided, Heard, Recorder
from gateway.robot.core.events import Announce, Completed, Effect, Rejected, Transmit
from gateway.robot.core.intake import echo_of
from gateway.robot.core.message import Reply
from gateway.robot.protocol.frames import leg_of
from gateway.robot.runtime.event_publisher import EventPublisher
from gateway.robot.runtime.metrics import Metrics
from schemas.telemetry import Ack, Kind, Reason

Servos = Sequence[tuple[int, object]]
"""The servos that a command names, each with what it asks of it."""


@dataclass(slots=True)
class _Pending:
    """A command that the supervisor has, and has not ended yet."""

    key: str
    source: str | None
    reply: Reply | None
    servos: Servos
    written: tuple[int, ...] = ()
    """The legs that a frame of it was written for."""


class Answers:
    """Knows who waits for which answer. Called by the owner of the state."""

    def __init__(self, metrics: Metrics, recorder: Recorder, events: EventPublisher) -> None:
        self._pending: dict[int, _Pending] = {}
        self._number = 0
        self._metrics = metrics
        self._recorder = recorder
        self._events = events

    def expect(self, key: str, source: str | None, reply: Reply | None, servos: Servos) -> int:
        """The number of a new command, which is answered under it."""
        self._number += 1
        self._pending[self._number] = _Pending(key, source, reply, servos)
        return self._number

    def wrote(self, transmit: Transmit) -> None:
        """A frame was written: should a command that it belongs to be rejected now, its answer names the leg."""
        for number in transmit.numbers:
            self._pending[number].written += (transmit.frame.leg,)

    def decided(self, effects: Sequence[Effect], fault: SpiError | None) -> Sequence[Decided]:
        """What the black box has of the commands that end with this step, in which the bus may have failed."""
        found: tuple[Decided, ...] = ()
        for effect in effects:
            match effect:
                case Rejected():
                    verdict: str = effect.reason
                case Completed() if fault is not None:
                    verdict = Reason.BUS_FAULT
                case Completed():
                    verdict = COALESCED if effect.coalesced else ACCEPTED
                case _:
                    continue
            pending = self._pending[effect.number]
            found += ((effect.number, verdict, pending.key, pending.source),)
        return found

    def end(self, end: Completed | Rejected, fault: SpiError | None) -> None:
        """Answer a command that the supervisor has ended."""
        pending = self._pending.pop(end.number)
        match end:
            case Rejected():
                self._reject(pending, end.reason, end.detail)
            case Completed() if fault is not None:
                self._reject(pending, Reason.BUS_FAULT, f"the frame could not be written: {fault}")
            case Completed():
                self._metrics.accepted += 1
                self._metrics.coalesced += end.coalesced
                if pending.reply is not None:
                    ack = Ack(accepted=True, coalesced=True if end.coalesced else None)
                    pending.reply(ack.model_dump_json().encode())

    def reject_unread(self, key: str, source: str | None, detail: str, reason: Reason = Reason.INVALID) -> None:
        """Publish that a message is rejected without being taken: on a key that nothing reads, or about the lease."""
        self.reject(echo_of(key), source, None, reason, detail)

    def reject(
        self,
        key: str,
        source: str | None,
        reply: Reply | None,
        reason: Reason,
        detail: str,
        *,
        servos: Servos = (),
        heard: Heard | None = None,
    ) -> None:
        """A message gets no further than this; `servos` and `heard` where it was read."""
        self._recorder.step(heard, (), ((0, reason, key, source),))
        self._reject(_Pending(key, source, reply, servos), reason, detail)

    def _reject(self, pending: _Pending, reason: Reason, detail: str) -> None:
        written = sorted(set(pending.written))
        if written:
            legs = f"leg{'s' if len(written) > 1 else ''} {', '.join(map(str, written))}"
            detail = f"{detail}; what it asks of {legs} had been written before"
        self._metrics.rejected[reason] += 1
        if pending.reply is not None:
            ack = Ack(accepted=False, reason=reason, detail=detail, written=written or None)
            pending.reply(ack.model_dump_json().encode())
        legs_named = legs_of(pending.servos)
        self._events.announce(Announce(Kind.COMMAND_REJECTED, detail, pending.source, pending.key, legs_named, reason))


def legs_of(servos: Servos) -> tuple[int, ...]:
    """Whose servos these are, ascending."""
    return tuple(sorted({leg_of(servo_id) for servo_id, _ in servos}))
