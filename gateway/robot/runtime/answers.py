"""What becomes of commands: counted, recorded, answered, and published where they are rejected."""

from collections.abc import Iterable, Sequence

from gateway.errors import SpiError
from gateway.model.frames import leg_of
from gateway.robot.blackbox.recorder import ACCEPTED, COALESCED, Decided, Recorder
from gateway.robot.core.events import Announce, Command, Completed, Effect, Rejected, Request, Transmit
from gateway.robot.core.intake import echo_of
from gateway.robot.runtime.event_publisher import EventPublisher
from gateway.robot.runtime.metrics import Metrics
from schemas.telemetry import Ack, Kind, Reason


class Answers:
    """Numbers commands, and answers them once. Called by the owner of the state."""

    def __init__(self, metrics: Metrics, recorder: Recorder, events: EventPublisher) -> None:
        self._number = 0
        self._metrics = metrics
        self._recorder = recorder
        self._events = events

    def next_number(self) -> int:
        """For a request that the supervisor is asked now."""
        self._number += 1
        return self._number

    def decided(self, effects: Sequence[Effect], fault: SpiError | None) -> Sequence[Decided]:
        """What the black box has of the requests that end with this step, in which the bus may have failed."""
        found: list[Decided] = []
        for effect in effects:
            match effect:
                case Transmit() | Completed():
                    for request in effect.done:
                        accepted = COALESCED if _is_coalesced(request) else ACCEPTED
                        found += [(request, accepted if fault is None else Reason.BUS_FAULT)]
                case Rejected():
                    found += [(effect.request, effect.reason)]
        return found

    def complete(self, effect: Transmit | Completed, fault: SpiError | None) -> None:
        """Answer what the supervisor has completed with this effect; all is rejected where its step's frames failed."""
        for request in effect.done:
            if fault is not None:
                self.end(request, Reason.BUS_FAULT, f"the frame could not be written: {fault}")
                continue
            coalesced = _is_coalesced(request)
            self._metrics.accepted += 1
            self._metrics.coalesced += coalesced
            if request.reply is not None:
                ack = Ack(accepted=True, coalesced=coalesced or None)
                request.reply(ack.model_dump_json().encode())

    def reject_unread(self, key: str, source: str | None, detail: str, reason: Reason = Reason.INVALID) -> None:
        """Publish that a message is rejected without being taken: on a key that nothing reads, or about the lease."""
        self.reject(Request(key=echo_of(key), source=source), reason, detail)

    def reject(self, request: Request, reason: Reason, detail: str, heard: Request | None = None) -> None:
        """A message gets no further than this; `heard`: a command that was read."""
        self._recorder.step(heard, (), ((request, reason),))
        self.end(request, reason, detail)

    def end(self, request: Request, reason: Reason, detail: str) -> None:
        """Answer what is rejected, and publish that."""
        written = sorted(set(request.written))
        if written:
            legs = f"leg{'s' if len(written) > 1 else ''} {', '.join(map(str, written))}"
            detail = f"{detail}; what it asks of {legs} had been written before"
        self._metrics.rejected[reason] += 1
        if request.reply is not None:
            ack = Ack(accepted=False, reason=reason, detail=detail, written=written or None)
            request.reply(ack.model_dump_json().encode())
        legs_named = legs_of(request.servo_ids)
        self._events.announce(Announce(Kind.COMMAND_REJECTED, detail, request.source, request.key, legs_named, reason))


def _is_coalesced(request: Request) -> bool:
    return type(request) is Command and request.coalesced


def legs_of(servo_ids: Iterable[int]) -> tuple[int, ...]:
    """Whose servos these are, ascending."""
    return tuple(sorted({leg_of(servo_id) for servo_id in servo_ids}))
