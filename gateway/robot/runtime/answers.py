"""Counts, records and answers the outcome of each command. Rejections are published, too."""

from collections.abc import Callable, Collection, Iterable, Sequence

from gateway.model.black_box.format import COALESCED
from gateway.model.frames import leg_of
from gateway.robot.core.events import Announce, Command, Request, Result
from gateway.robot.core.intake import echo_of
from gateway.robot.runtime.event_publisher import EventPublisher
from schemas.telemetry import Ack, Kind, Reason

Confirm = Callable[[Collection[int], int, Callable[[bool, float | None], None]], None]
"""Asks the power board to confirm that these servos are off, for a Stop received at this time (ns). Calls back once:
whether they are confirmed off, and after how many ms."""


class PendingCommands:
    """Numbers commands and answers each once. For the owner of the state."""

    def __init__(self, events: EventPublisher, confirm: Confirm | None = None) -> None:
        """Answers to Stops wait for the power board's `confirm`. None: there is no board."""
        self._number = 0
        self._metrics = events.metrics
        self._events = events
        self._confirm = confirm

    def next_number(self) -> int:
        """Return the number for the next request to the supervisor."""
        self._number += 1
        return self._number

    def take(self, results: Sequence[Result]) -> None:
        """Count and answer the requests that a step has ended."""
        for request, verdict, detail in results:
            if type(verdict) is Reason:
                self.end(request, verdict, detail)
                continue
            if isinstance(request, Command) and request.lost:
                continue  # no client sent it
            coalesced = verdict == COALESCED
            self._metrics.accepted += 1
            self._metrics.coalesced += coalesced
            if request.reply is not None:
                ack = Ack(accepted=True, coalesced=coalesced or None)
                if self._confirm is not None and request.only_stops:
                    self.stopped(tuple(request.servo_ids), request, ack)
                else:
                    request.reply(ack.model_dump_json().encode())

    # mutants accepted (Forget): no caller asks where nobody waits
    def stopped(self, servo_ids: Collection[int], request: Request, ack: Ack) -> None:
        """Answer a request that has stopped these servos. With a power board, wait for its confirmation."""
        reply = request.reply
        if reply is None:
            return
        if self._confirm is None:
            reply(ack.model_dump_json().encode())
            return

        def confirmed(whether: bool, ms: float | None) -> None:
            reply(ack.model_copy(update={"confirmed": whether, "confirmed_ms": ms}).model_dump_json().encode())

        self._confirm(servo_ids, request.received_ns, confirmed)

    def reject_unread(self, key: str, source: str | None, detail: str, reason: Reason = Reason.INVALID) -> None:
        """Reject a message on a key that takes no commands: an unknown key, or a key for `get` only."""
        self.reject(Request(key=echo_of(key), source=source), reason, detail)

    def reject(self, request: Request, reason: Reason, detail: str, received: Request | None = None) -> None:
        """Reject a message before the supervisor decides. `received` is its command, if it could be read."""
        self._events.recorder.step(received, (), ((request, reason, detail),))
        self.end(request, reason, detail)

    def end(self, request: Request, reason: Reason, detail: str) -> None:
        """Answer a rejected request and publish the rejection."""
        written = sorted(set(request.written))
        if written:
            legs = f"leg{'s' if len(written) > 1 else ''} {', '.join(map(str, written))}"
            detail = f"{detail}; what it asks of {legs} had been written before"
        self._metrics.rejected[reason] += 1
        if request.reply is not None:
            ack = Ack(accepted=False, reason=reason, detail=detail, written=written or None)
            if request.stopped:
                ack = ack.model_copy(update={"stopped": True})
                self.stopped(request.stopped, request, ack)
            else:
                request.reply(ack.model_dump_json().encode())
        legs_named = legs_of(request.servo_ids)
        self._events.announce(Announce(Kind.COMMAND_REJECTED, detail, request.source, request.key, legs_named, reason))


def legs_of(servo_ids: Iterable[int]) -> tuple[int, ...]:
    """Return the legs of these servos, ascending."""
    return tuple(sorted({leg_of(servo_id) for servo_id in servo_ids}))
