"""What a gateway publishes, made by hand, and what a robot that measures publishes."""

from collections.abc import Collection
from contextlib import AbstractContextManager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from gateway.client import Client
from gateway.model.elkapod import Measured
from schemas import keys
from schemas.event import Event
from schemas.gateway_state import (
    CommandCounts,
    GatewayState,
    LegReport,
    ServoReport,
    SpiReport,
    StopLatency,
    WatchdogReport,
)
from schemas.robot import JOINTS, LEGS
from schemas.telemetry import Battery, Imu, Telemetry
from schemas.words import Kind, Mode, Reason, WatchdogState
from tests.support.waiting import meanwhile

NS_PER_MS = 1_000_000
WALL = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
_RECORDED = Path(__file__).parents[1] / "data" / "wire"


def payloads_of(version: str) -> dict[str, list[str]]:
    """Return the payloads that a gateway of this version has published, by their kind. A line has both."""
    found: dict[str, list[str]] = {}
    for line in (_RECORDED / f"{version}.txt").read_text().splitlines():
        kind, _, payload = line.partition(" ")
        found.setdefault(kind, []).append(payload)
    return found


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


MEASURED: Final = Telemetry(
    time=WALL,
    age_ms=12.5,
    temperature_c=31.5,
    battery=Battery(voltage_v=7.4, percent=80.0),
    imu=Imu(
        orientation_wxyz=(1.0, 0.0, 0.0, 0.0),
        angular_velocity_rad_s=(0.0, 0.0, 0.5),
        linear_acceleration_m_s2=(0.0, 0.0, 9.81),
    ),
    tilt_deg=0.0,
    feet=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
)
"""Of an Elkapod that turns on the spot."""
LEANING: Final = MEASURED.model_copy(
    update={
        "imu": Imu(
            orientation_wxyz=(0.9914, 0.1305, 0.0, 0.0),
            angular_velocity_rad_s=(0.0, 0.0, 0.0),
            linear_acceleration_m_s2=(0.0, 0.0, 9.81),
        ),
        "tilt_deg": 15.0,
        "feet": (9.0, 0.0, 0.1, 11.0, 8.0, -0.2),
    }
)
"""It leans by 15° to the right, on feet 1, 4 and 5."""
_PERIOD_S: Final = 0.1


def measures(client: Client, telemetry: Telemetry) -> AbstractContextManager[None]:
    """Return a robot that measures this, ten times a second."""
    return meanwhile(lambda: client.session.put(keys.TELEMETRY, telemetry.model_dump_json()), _PERIOD_S)


AT_REST: Final = Measured(
    temperature_c=31.5,
    voltage_v=7.5,
    percent=80.0,
    orientation_wxyz=(1.0, 0.0, 0.0, 0.0),
    angular_velocity_rad_s=(0.0, 0.25, 0.0),
    linear_acceleration_m_s2=(0.0, 0.0, 9.75),
    feet=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
)
ON_ITS_SIDE: Final = AT_REST._replace(orientation_wxyz=(0.75, 0.65625, 0.0, 0.0))
"""Tilted by some 82 degrees."""
