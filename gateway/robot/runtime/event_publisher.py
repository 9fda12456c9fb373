"""Publishes events to the log, to Zenoh and to the black box, with a rate limit for each source and kind."""

import logging
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Final

from gateway.allowance import AllowanceBySource
from gateway.robot.blackbox.recorder import LIMITED, Recorder, Written
from gateway.robot.core.events import Announce
from gateway.robot.core.intake import named_source
from gateway.robot.core.message import Outbox, Received
from gateway.robot.runtime.metrics import Metrics
from schemas import keys, telemetry
from schemas.telemetry import Kind

EVENTS_A_SECOND: Final = 10
EVENTS_AT_ONCE: Final = 10
"""Events of each source and kind that may come at once."""

INFORMATIONAL: Final = frozenset(
    {
        Kind.STARTED,
        Kind.STOPPING,
        Kind.ESTOP_RESET,
        Kind.BUS_RECOVERED,
        Kind.CONTROLLER_RETURNED,
        Kind.SOURCE_CHANGED,
        *(kind for kind in Kind if kind.startswith("lease_")),
        Kind.CALIBRATED,
        Kind.BUTTON_REGISTERED,
        Kind.BUTTON_RETURNED,
        Kind.POWER_CUT,
        Kind.POWER_RESTORED,
    }
)
"""Kinds that are logged as information; the others are warnings."""

logger: Final = logging.getLogger(__name__)


def wall_clock() -> datetime:
    """Now in UTC, for people; no decision depends on it."""
    return datetime.now(UTC)


class EventPublisher:
    """Publishes events. For the owner of the state; `clock` returns the monotonic time in ns."""

    def __init__(self, outbox: Outbox, recorder: Recorder, metrics: Metrics, clock: Callable[[], int]) -> None:
        self.outbox = outbox
        self.recorder = recorder
        self.metrics = metrics
        self.clock = clock
        self._limits = {kind: AllowanceBySource(EVENTS_A_SECOND, EVENTS_AT_ONCE) for kind in LIMITED}
        self.unread_estop: Received | None = None
        """The latest emergency stop request, whose payload is parsed after its Stops."""
        self._estop_source: str | None = None

    @property
    def estop_source(self) -> str | None:
        """The source of the latest emergency stop. Reading it parses a payload, so read it after the Stops."""
        if self.unread_estop is not None:
            self._estop_source = named_source(self.unread_estop.payload) or self.unread_estop.source
            self.unread_estop = None
        return self._estop_source

    def restore_estop(self, source: str | None) -> None:
        """Set the source of an emergency stop that an earlier run left engaged."""
        self._estop_source = source

    def announce(self, what: Announce) -> None:
        """Publish an event, unless its kind and source exceed their rate limit."""
        kind = what.kind
        self.metrics.events[kind] += 1
        source = self.estop_source if kind is Kind.ESTOP_ENGAGED else what.source
        limit = self._limits.get(kind)
        left_out = 0 if limit is None else limit.admit(source, self.clock())
        if left_out is None:
            return
        incident = self.recorder.event(what, source, left_out)
        extra = {
            "kind": kind, "source": source, "key": what.key, "reason": what.reason, "left_out": left_out or None,
            "legs": list(what.legs) or None, "incident": incident,
        }  # fmt: skip
        logger.log(logging.INFO if kind in INFORMATIONAL else logging.WARNING, what.detail, extra=extra)
        event = telemetry.Event(
            time=wall_clock(), kind=kind, source=source, key=what.key, reason=what.reason, detail=what.detail,
            left_out=left_out, legs=what.legs, incident=incident,
        )  # fmt: skip
        self.outbox.publish(keys.EVENT, event)

    def frames(self, written: Sequence[Written]) -> None:
        """Publish a step's frames, after the last was written."""
        for transmit, sent in written:
            record = telemetry.FrameRecord(
                time=wall_clock(), monotonic_ns=sent.ns, bytes=sent.data.hex(), cause=transmit.cause
            )
            self.outbox.publish(keys.FRAME, record)
