"""The service's counters and latencies: plain numbers that the state's owner writes and `prometheus` serves."""

from collections import Counter
from dataclasses import dataclass, field

from gateway.robot.protocol.latency import Latency
from schemas.telemetry import Cause, Kind, Reason


@dataclass(slots=True)
class Metrics:
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
    """Open Zenoh sessions: laptops, routers, programs on this machine."""
    loop_lag: Latency = field(default_factory=Latency)
    """How late the loop's timers run."""

    def count_sessions(self, number: int) -> None:
        """Set the number of open sessions. The caller need not own the state: no decision depends on the number."""
        self.sessions = number
