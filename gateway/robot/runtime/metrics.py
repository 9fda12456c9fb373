"""The service's counters and latencies: plain numbers, written by the state's owner, exposed by `prometheus`."""

from collections import Counter
from dataclasses import dataclass, field

from gateway.robot.protocol.latency import Latency
from schemas.telemetry import Cause, Kind, Reason


@dataclass(slots=True)
class Metrics:
    """One service's counters and latencies."""

    accepted: int = 0
    coalesced: int = 0
    overflows: int = 0
    """Times that a ring overflowed, so that messages of its key were lost."""
    lost: int = 0
    """Messages skipped undecoded after an overflow: at least so many were lost."""
    rejected: Counter[Reason] = field(default_factory=Counter)
    frames: Counter[Cause] = field(default_factory=Counter)
    events: Counter[Kind] = field(default_factory=Counter)
    """Published, or left out for their rate."""
    watchdog_stops: Latency = field(default_factory=Latency)
    """From a deadline to its Stop written."""
    emergency_stops: Latency = field(default_factory=Latency)
    """From the request received to the sixth Stop written, of requests whose Stops were written."""
    sessions: int = 0
    """Open Zenoh sessions: laptops, routers, programs on this machine."""
    loop_lag: Latency = field(default_factory=Latency)
    """How late the loop's timers run."""

    def count_sessions(self, number: int) -> None:
        """Without owning the state: no decision depends on it."""
        self.sessions = number
