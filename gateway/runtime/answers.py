"""What becomes of commands: counted, recorded, answered, and told where they are rejected."""

import itertools
from collections.abc import Callable

from gateway.core.events import Completed
from gateway.core.intents import MAX_KEY
from gateway.core.message import Reply
from gateway.recorder.recorder import Recorder
from gateway.runtime.metrics import Metrics
from gateway.runtime.sources import Sources, Tell
from schemas.telemetry import Ack, Kind, Reason

Sender = tuple[str, str | None, Reply | None]
"""Of a command that the supervisor knows by its number: its key, its source, and how it is answered."""


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
        self._metrics = metrics
        self._recorder = recorder
        self._sources = sources
        self._tell = tell
        self._clock = clock

    def expect(self, key: str, source: str | None, reply: Reply | None) -> int:
        """The number of a new command, which is answered under it."""
        number = next(self.numbers)
        self.pending[number] = key, source, reply
        return number

    def accept(self, completed: Completed) -> None:
        """A command has taken effect."""
        self._metrics.accepted += 1
        self._metrics.coalesced += completed.coalesced
        key, source, reply = self.pending.pop(completed.number)
        self._recorder.decided(completed.number, "coalesced" if completed.coalesced else "accepted", key, source)
        if reply is not None:
            reply(Ack(accepted=True, coalesced=True if completed.coalesced else None).model_dump_json().encode())

    def reject_pending(self, number: int, reason: Reason, detail: str) -> None:
        """A command that the supervisor knows takes no effect."""
        self.rejected = number
        key, source, reply = self.pending.pop(number)
        self.reject(key, source, reply, reason, detail, number)

    def reject_unread(self, key: str, source: str | None, detail: str, reason: Reason = Reason.INVALID) -> None:
        """Tell of a message that is rejected without being taken: on a key that nothing reads, or about the lease."""
        self.reject(key[:MAX_KEY], source, None, reason, detail)

    def reject(
        self, key: str, source: str | None, reply: Reply | None, reason: Reason, detail: str, number: int = 0
    ) -> None:
        """A message takes no effect; without a number it gets no further than this."""
        self._metrics.rejected[reason] += 1
        self._recorder.decided(number, reason, key, source)
        if reply is not None:
            reply(Ack(accepted=False, reason=reason, detail=detail).model_dump_json().encode())
        left_out = self._sources.rejections.admit(source, self._clock())
        if left_out is not None:
            self._tell(Kind.COMMAND_REJECTED, detail, source, key, reason, left_out)
