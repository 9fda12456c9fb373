"""What the service counts and times. Plain numbers, written by the state's owner; `prometheus` shows them."""

from collections import Counter
from dataclasses import dataclass, field

from gateway.robot.core.latency import Latency
from schemas.telemetry import Cause, Kind, Reason


@dataclass(slots=True)
class Metrics:
    """One service's counters and latencies."""

    accepted: int = 0
    coalesced: int = 0
    overflows: int = 0
    """How often messages of a key were lost, as more came at once than are kept."""
    lost: int = 0
    """Messages that were then passed over without being decoded: at least so many were lost."""
    rejected: Counter[Reason] = field(default_factory=Counter)
    frames: Counter[Cause] = field(default_factory=Counter)
    events: Counter[Kind] = field(default_factory=Counter)
    """What the supervisor has announced, published or not."""
    watchdog_stops: Latency = field(default_factory=Latency)
    """Deadline → its Stop written."""
    emergency_stops: Latency = field(default_factory=Latency)
    """Request received → sixth Stop written; requests whose Stops could not be written are not in it."""
    sessions: int = 0
    """Zenoh sessions that are open: laptops, routers, programs on this machine."""
    older_ca: int = 0
    """Laptops that came with a certificate of the older of two CAs."""
    loop_lag: Latency = field(default_factory=Latency)
    """How late the loop's timers run."""

    def count_older_ca(self, number: int) -> None:
        """Called by a thread that owns nothing."""
        self.older_ca = number

    def count_sessions(self, number: int) -> None:
        """Called by a thread that owns nothing."""
        self.sessions = number
