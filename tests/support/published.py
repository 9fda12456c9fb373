"""What a gateway publishes, made by hand."""

from collections.abc import Collection
from datetime import UTC, datetime, timedelta

from schemas.robot import JOINTS, LEGS
from schemas.telemetry import (
    CommandCounts,
    Event,
    GatewayState,
    Kind,
    LegReport,
    Mode,
    Reason,
    ServoReport,
    SpiReport,
    StopLatency,
    WatchdogReport,
    WatchdogState,
)

NS_PER_MS = 1_000_000
WALL = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def state(
    uptime_s: float = 10.0,
    mode: Mode = Mode.IDLE,
    *,
    running: Collection[int] = (),
    started_s: float = 0.0,
) -> GatewayState:
    """Return a state of the gateway that was started at `started_s`, as far as `WALL` goes. `running`: these legs."""
    return GatewayState(
        mode=mode,
        time=WALL + timedelta(seconds=started_s + uptime_s),
        uptime_s=uptime_s,
        version="0.1.0",
        protocol="1.0.0",
        simulated=True,
        legs=tuple(leg(number, number in running) for number in LEGS),
        commands=CommandCounts(accepted=0, rejected=0, coalesced=0),
        spi=SpiReport(device="simulated controller", framing="plain", frames=0, errors=0),
        watchdog=WatchdogReport(
            timeout_ms=250, expirations=0, stop_latency_us=StopLatency(p50=None, p99=None, max=None)
        ),
    )


def leg(number: int, running: bool) -> LegReport:
    first, second, third = (servo(10 * number + joint, running) for joint in JOINTS)
    return LegReport(leg=number, watchdog=WatchdogState.IDLE, age_ms=None, servos=(first, second, third))


def servo(servo_id: int, running: bool) -> ServoReport:
    return ServoReport(id=servo_id, running=running, angle_deg=90.0 if running else None)


def event(
    kind: Kind, detail: str = "", source: str | None = None, reason: Reason | None = None, left_out: int = 0
) -> Event:
    return Event(time=WALL, kind=kind, source=source, key=None, reason=reason, detail=detail, left_out=left_out)


def rejected(source: str | None, detail: str = "no", reason: Reason = Reason.INVALID, left_out: int = 0) -> Event:
    return event(Kind.COMMAND_REJECTED, detail, source, reason, left_out)
