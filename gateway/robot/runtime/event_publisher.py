"""Publishes events to the log, to Zenoh and to the black box, with a rate limit for each source and kind."""

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

from gateway.allowance import AllowanceBySource
from gateway.robot.blackbox.recorder import LIMITED, Recorder, Written
from gateway.robot.core.events import Announce
from gateway.robot.core.intake import named_source
from gateway.robot.core.message import Outbox, Received
from gateway.robot.protocol.latency import Latency
from schemas import keys, telemetry
from schemas.telemetry import Cause, Kind, Reason

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


@dataclass(slots=True)
class Metrics:
    """The service's counters and latencies: plain numbers that the state's owner writes and `prometheus` serves."""

    accepted: int = 0
    coalesced: int = 0
    overflows: int = 0
    """Times that a ring overflowed, so that messages of its key were lost."""
    lost: int = 0
    """Messages skipped undecoded after an overflow: the least number that was lost."""
    rejected: Counter[Reason] = field(default_factory=Counter)
    frames: Counter[Cause] = field(default_factory=Counter)
    events: Counter[Kind] = field(default_factory=Counter)
    """Events published, or omitted by the rate limit."""
    watchdog_stops: Latency = field(default_factory=Latency)
    """The time from a deadline until its Stop is written."""
    emergency_stops: Latency = field(default_factory=Latency)
    """The time from a received request until its sixth Stop is written, without requests whose Stops failed."""
    sessions: int = 0
    """Open Zenoh sessions: laptops, routers, programs on this machine. Set without owning the state."""
    loop_lag: Latency = field(default_factory=Latency)
    """How late the loop's timers run."""


@dataclass
class EventPublisher:
    """Publishes events. For the owner of the state; `clock` returns the monotonic time in ns."""

    outbox: Outbox
    recorder: Recorder
    clock: Callable[[], int]
    metrics: Metrics = field(default_factory=Metrics)
    estop: Received | str | None = None
    """The latest emergency stop: its request, whose payload is parsed after its Stops, or its source."""

    def __post_init__(self) -> None:
        self._limits = {kind: AllowanceBySource(EVENTS_A_SECOND, EVENTS_AT_ONCE) for kind in LIMITED}

    @property
    def estop_source(self) -> str | None:
        """The source of the latest emergency stop. Reading it parses a payload, so read it after the Stops."""
        if isinstance(self.estop, Received):
            self.estop = named_source(self.estop.payload) or self.estop.source
        return self.estop

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
