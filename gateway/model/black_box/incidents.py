"""The events that are kept as incidents, their duration, and their ids."""

from datetime import UTC, datetime
from typing import Final

from schemas.telemetry import Kind

FOLLOW_NS: Final = 5_000_000_000
"""An incident includes the 5 s after its latest event."""
LONGEST_INCIDENT_NS: Final = 30_000_000_000
"""Later events prolong an incident up to this."""
LANDING_NS: Final = 5_000_000_000
"""The highest `watchdog.landing_ms`: the Stops at a landing's end belong to its incident."""

INCIDENT_NAMES: Final = {
    Kind.WATCHDOG_EXPIRED: "watchdog",
    Kind.LANDING: "landing",
    Kind.ESTOP_ENGAGED: "estop",
    Kind.BUS_FAULT: "bus-fault",
    Kind.CONTROLLER_SILENT: "controller-silent",
    Kind.CONTROLLER_RESTARTED: "controller-restarted",
    Kind.FALLEN: "fallen",
    Kind.OVERFLOW: "overflow",
    Kind.LEASE_TAKEN: "lease-taken",
    Kind.STOPPED_OUTSIDE: "stopped-outside",
    Kind.BUTTON_SILENT: "button",
    Kind.BUTTON_LEFT: "button",
    Kind.POWER_UNCONFIRMED: "power-unconfirmed",
    Kind.POWER_FAULT: "power-fault",
    Kind.SERVO_DRAWS: "servo-draws",
    Kind.OFF_BUTTON: "off-button",
}
"""Events that are kept as incidents, and the ends of their ids."""
MISTAKE: Final = "mistake"
"""An unexpected exception has ended the service."""


def follow_ns(what: str) -> int:
    """Return how long (ns) later events belong to an incident: `what` is the end of its id, or a later event's kind."""
    return FOLLOW_NS + LANDING_NS if what == Kind.LANDING else FOLLOW_NS


def incident_id(wall_ns: int, what: str) -> str:
    """Return an id such as 20261122-001233-123-watchdog: the time in UTC to the millisecond, and `what` happened."""
    seconds, ns = divmod(wall_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y%m%d-%H%M%S}-{ns // 1_000_000:03d}-{what}"
