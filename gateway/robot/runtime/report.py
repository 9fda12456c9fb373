"""Makes the states, whose parts are the payloads of `hexapod/state` and `hexapod/config`."""

from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Final

from pydantic import BaseModel

from gateway import __version__
from gateway.host.settings_table import ServoLimits
from gateway.model.frames import Op
from gateway.robot.core.buttons import Buttons
from gateway.robot.core.lease import RobotLease
from gateway.robot.core.leg import Leg, Servo
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.protocol import Wire
from gateway.robot.runtime.metrics import Metrics
from gateway.robot.settings import Settings
from schemas import keys
from schemas.robot import SERVO_IDS
from schemas.state import Payloads
from schemas.telemetry import (
    Battery,
    ButtonsReport,
    CalibrationReport,
    CertificateReport,
    CommandCounts,
    ConfigReport,
    ControllerReport,
    GatewayState,
    Kind,
    LeaseReport,
    LegReport,
    LimitsReport,
    LoopLag,
    PowerReport,
    RevocationsReport,
    ServoLimitsReport,
    ServoReport,
    SpiReport,
    StopLatency,
    TelemetryReport,
    WatchdogReport,
    WireReport,
)

WARNINGS: Final = frozenset(
    {
        Kind.COMMAND_REJECTED,
        Kind.WATCHDOG_EXPIRED,
        Kind.LANDING,
        Kind.ESTOP_ENGAGED,
        Kind.ESTOP_KEPT,
        Kind.ESTOP_NOT_KEPT,
        Kind.BUS_FAULT,
        Kind.BUS_MEDDLED,
        Kind.STOPPED_OUTSIDE,
        Kind.OVERFLOW,
        Kind.REVOKED,
        Kind.BUTTON_SILENT,
        Kind.BUTTON_LEFT,
        Kind.CONTROLLER_SILENT,
        Kind.CONTROLLER_RESTARTED,
        Kind.BATTERY_LOW,
        Kind.FALLEN,
        Kind.POWER_UNCONFIRMED,
        Kind.POWER_FAULT,
        Kind.SERVO_DRAWS,
        Kind.SERVO_SILENT,
        Kind.OFF_BUTTON,
    }
)
"""Kinds that are logged as warnings; the others are informational."""


def wall_clock() -> datetime:
    """Now in UTC, for people; no decision depends on it."""
    return datetime.now(UTC)


class StateReports:
    """Makes the states of one run of the service."""

    def __init__(
        self, settings: Settings, *, simulated: bool, physics: str | None, calibration_kept: bool, started_ns: int
    ) -> None:
        self._settings = settings
        self._simulated = simulated
        self._physics = physics
        self._calibration_kept = calibration_kept
        """Whether the calibration outlasts this process."""
        self._started_ns = started_ns
        self._limits = limits_of(settings)
        wire = settings.wire
        can = wire.capabilities._replace(whole_robot=settings.starts_whole)
        self._wire = WireReport(name=wire.name, supply_starts=wire.supply_starts, **can._asdict())
        self.measures = wire.capabilities.measures
        self.protocol = settings.protocol
        self.certificate: CertificateReport | None = None
        """The first certificate in use to expire; None: none is in use."""
        self._missing: tuple[str, ...] = ()
        self.estop_since: datetime | None = None
        """Since when the emergency stop is engaged; None: it is not."""
        self.estop_fault: str | None = None
        """Why the emergency stop may not outlast a restart, or counts as engaged."""
        self.payloads = Payloads()
        self._published: ConfigReport | None = None
        self.revocations: RevocationsReport | None = None
        """The list in force; None: there is none."""

    def has_missing(self, endpoints: tuple[str, ...]) -> None:
        """Report these as not listened on yet. Callable from any thread."""
        self._missing = endpoints

    def publish(self, state: GatewayState, publish: Callable[[str, BaseModel], None]) -> None:
        """Publish the state, and before it the configuration if that has changed."""
        report, config = self.payloads.of(state)
        if config != self._published:
            self._published = config
            publish(keys.CONFIG, config)
        publish(keys.STATE, report)

    def state(
        self,
        supervisor: Supervisor,
        bus: Wire,
        metrics: Metrics,
        now_ns: int,
        *,
        estop_source: str | None,
        incident: str | None,
        battery: Battery | None,
        power: PowerReport | None,
    ) -> GatewayState:
        """The state at `now_ns`."""
        settings = self._settings
        p50_us, p99_us = metrics.watchdog_stops.p50_p99_us()
        return GatewayState(
            mode=supervisor.mode,
            time=wall_clock(),
            uptime_s=(now_ns - self._started_ns) / 1e9,
            version=__version__,
            protocol=self.protocol,
            simulated=self._simulated,
            physics=self._physics,
            legs=tuple(_leg(leg, now_ns) for leg in supervisor.legs),
            commands=CommandCounts(
                accepted=metrics.accepted,
                rejected=metrics.rejected.total(),
                coalesced=metrics.coalesced,
                overflows=metrics.overflows,
                lost=metrics.lost,
            ),
            spi=SpiReport(
                device="simulated controller" if self._simulated else settings.device,
                framing=settings.framing,
                frames=bus.frames,
                errors=bus.errors,
            ),
            watchdog=WatchdogReport(
                timeout_ms=settings.watchdog.timeout_ms,
                landing_ms=settings.watchdog.landing_ms,
                expirations=supervisor.watchdog.expirations,
                stop_latency_us=StopLatency(p50=p50_us, p99=p99_us, max=metrics.watchdog_stops.max_us),
            ),
            estop=supervisor.latch.number,
            estop_source=estop_source,
            estop_since=self.estop_since,
            estop_fault=self.estop_fault,
            incident=incident,
            loop_lag_us=LoopLag(
                p50=metrics.loop_lag.at_most_us(0.5), p99=metrics.loop_lag.at_most_us(0.99), max=metrics.loop_lag.max_us
            ),
            lease=_lease(supervisor.lease, now_ns),
            buttons=_buttons(supervisor.buttons),
            calibration=CalibrationReport(
                revision=supervisor.calibrating.in_force.revision,
                fault=supervisor.calibrating.fault,
                kept=self._calibration_kept,
            ),
            telemetry=TelemetryReport(frames=settings.telemetry.frames),
            certificate=self.certificate,
            missing_endpoints=self._missing,
            revocations=self.revocations,
            limits=self._limits,
            wire=self._wire,
            controller=_controller(bus, now_ns),
            battery=battery,
            power=power,
        )


def limits_of(settings: Settings) -> LimitsReport:
    """The settings' limits, as in the state."""
    limits = settings.limits
    each = {name: limits.servos.get(name, ServoLimits()) for name in map(str, SERVO_IDS)}
    servos = {name: ServoLimitsReport(**asdict(of_servo)) for name, of_servo in each.items()}
    return LimitsReport(leg_rate_hz=limits.leg_rate_hz, max_age_ms=limits.max_age_ms, servos=servos)


def _lease(lease: RobotLease, now_ns: int) -> LeaseReport:
    return LeaseReport(
        holder=lease.holder,
        verified=lease.verified,
        held_s=None if lease.since_ns is None else (now_ns - lease.since_ns) / 1e9,
        expires_in_ms=None if lease.due_ns is None else max(0.0, (lease.due_ns - now_ns) / 1e6),
        asked_by=lease.asked_by,
    )


def _buttons(buttons: Buttons) -> ButtonsReport:
    return ButtonsReport(required=buttons.required, alive=buttons.alive, names=buttons.names)


def _controller(bus: Wire, now_ns: int) -> ControllerReport:
    age_ms = None if bus.answered_ns is None else max(0, now_ns - bus.answered_ns) / 1e6
    return ControllerReport(alive=bus.controller_alive, age_ms=age_ms)


def _leg(leg: Leg, now_ns: int) -> LegReport:
    first, second, third = map(_servo, leg.servos)
    return LegReport(
        leg=leg.number,
        watchdog=leg.watchdog,
        age_ms=None if leg.heard_ns is None else (now_ns - leg.heard_ns) / 1e6,
        servos=(first, second, third),
        source=leg.source,
    )


def _servo(servo: Servo) -> ServoReport:
    target_cdeg = servo.angle_cdeg if servo.target_cdeg is None else servo.target_cdeg
    if servo.waiting is not None and servo.waiting.op is not Op.STOP:
        target_cdeg = servo.waiting.angle_cdeg
    return ServoReport(
        id=servo.servo_id,
        running=servo.running,
        angle_deg=None if servo.angle_cdeg is None else servo.angle_cdeg / 100,
        target_deg=None if target_cdeg is None else target_cdeg / 100,
    )
