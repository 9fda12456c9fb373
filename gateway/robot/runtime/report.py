"""Makes the payloads of `hexapod/state`, `hexapod/config` and `hexapod/telemetry`."""

import logging
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Final, NamedTuple

from pydantic import BaseModel

from gateway import __version__
from gateway.host.settings_table import ServoLimits
from gateway.model import power_board
from gateway.model.elkapod import Measured
from gateway.model.telemetry import report_of
from gateway.robot.core.events import Announce
from gateway.robot.core.leg import Leg
from gateway.robot.core.message import Reply
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.power.board import Status
from gateway.robot.runtime.event_publisher import EventPublisher, wall_clock
from gateway.robot.runtime.supply import RobotSupply
from gateway.robot.settings import Settings
from gateway.robot.spi import Wire
from schemas import keys, telemetry
from schemas.robot import SERVO_IDS
from schemas.state import LegsReport, StateReport
from schemas.telemetry import Kind, Mode

_CONVERTERS: Final = (power_board.CONVERTERS_1_TO_3_MV, power_board.CONVERTERS_4_5_MV)

logger: Final = logging.getLogger(__name__)


class Measurement(NamedTuple):
    """Measured values, and when they were received, in ns of the monotonic clock."""

    values: Measured
    ns: int


@dataclass
class RobotReports:
    """Makes and publishes the reports of one run. For the owner of the state."""

    settings: Settings
    supervisor: Supervisor
    bus: Wire
    events: EventPublisher
    supply: RobotSupply | None

    def __post_init__(self) -> None:
        self._started_ns = self.events.clock()
        self._limits = limits_of(self.settings)
        wire = self.settings.wire
        can = wire.capabilities._replace(whole_robot=self.settings.starts_whole)
        self._wire = telemetry.WireReport(name=wire.name, supply_starts=wire.has_uart, **can._asdict())
        self.certificate: telemetry.CertificateReport | None = None
        """The certificate in use that expires first, or None."""
        self.missing_endpoints: tuple[str, ...] = ()
        """The endpoints on which the gateway does not listen yet. Any thread may set it."""
        self.newest: Measurement | None = None
        """The controller's newest. They stay when it falls silent: their age shows that. Any thread may read it."""
        self.estop_since: datetime | None = None
        """When the emergency stop was engaged; None: it is not engaged."""
        self.estop_fault: str | None = None
        """Why the emergency stop may not outlast a restart, or counts as engaged."""
        self.revocations: telemetry.RevocationsReport | None = None
        self.simulated = False
        """Whether the controller is simulated."""
        self.physics: str | None = None
        """The Zenoh id of the process that simulates the robot's body, if there is one."""
        self.calibration_kept = False
        """Whether the next boot finds the calibration."""
        self._plain: telemetry.ConfigReport | None = None
        """The newest configuration without its checksum, which takes as long as all the rest."""
        self._published: telemetry.ConfigReport | None = None
        self.published_mode: Mode | None = None
        """The mode last published; None until the start is announced."""

    def announce_start(self) -> None:
        """Publish that commands are accepted from now on."""
        self.events.announce(Announce(Kind.STARTED, f"hexapod-gateway {__version__} takes commands"))
        self.published_mode = Mode.STARTING
        self.publish_mode()

    def publish_mode(self) -> None:
        """Publish the state if its mode has changed."""
        mode = self.supervisor.mode
        if mode is not self.published_mode is not None:
            self.published_mode = mode
            self.events.recorder.mode(mode)
            logger.info("mode %s", mode, extra={"mode": mode})
            self.publish()

    def publish(self) -> None:
        """Publish the state. If the configuration has changed, publish that first."""
        config = self.config()
        if config != self._published:
            self._published = config
            self.events.outbox.publish(keys.CONFIG, config)
        self.events.outbox.publish(keys.STATE, self.state(config))

    def publish_telemetry(self) -> None:
        report = self.measured()
        if report is not None:
            self.events.outbox.publish(keys.TELEMETRY, report)

    def answer(self, key: str, reply: Reply) -> None:
        """Answer a `get` on the key of the state, the configuration or telemetry.

        Without any measurements, the query ends without an answer. So a robot that measures nothing, one that has not
        measured yet, and an older gateway look the same.
        """
        report: BaseModel | None = self.measured() if key == keys.TELEMETRY else self.config()
        if key == keys.STATE:
            report = self.state(self.config())
        if report is not None:
            reply(report.model_dump_json().encode())

    def power(self) -> telemetry.PowerReport | None:
        """Return the power board's report, or None without a board. For any thread."""
        return None if self.supply is None else self.supply.report(self.events.clock())

    def measured(self) -> telemetry.Telemetry | None:
        """Return the measurements of the robot and its power board, or None without any. For any thread."""
        now_ns, time = self.events.clock(), wall_clock()
        found = {} if self.supply is None else board_values(self.supply.line.status, now_ns)
        newest = self.newest
        if newest is not None:
            report = report_of(newest.values, time, max(0, now_ns - newest.ns) / 1e6)
            found = {**dict(report), **found, "age_ms": max(report.age_ms, found.get("age_ms", 0.0))}
        return telemetry.Telemetry.model_validate({**found, "time": time}) if found else None

    def config(self) -> telemetry.ConfigReport:
        """Return what seldom changes, with its checksum."""
        settings, calibrating = self.settings, self.supervisor.calibrating
        plain = telemetry.ConfigReport(
            version=__version__,
            protocol=settings.protocol,
            simulated=self.simulated,
            spi=telemetry.SpiConfig(
                device="simulated controller" if self.simulated else settings.device, framing=settings.framing
            ),
            watchdog=telemetry.WatchdogConfig(
                timeout_ms=settings.watchdog.timeout_ms, landing_ms=settings.watchdog.landing_ms
            ),
            buttons=telemetry.ButtonsConfig(required=settings.buttons.required),
            calibration=telemetry.CalibrationReport(
                revision=calibrating.in_force.revision, fault=calibrating.fault, kept=self.calibration_kept
            ),
            telemetry=telemetry.TelemetryReport(frames=settings.telemetry.frames),
            certificate=self.certificate,
            missing_endpoints=self.missing_endpoints,
            revocations=self.revocations,
            limits=self._limits,
            wire=self._wire,
            physics=self.physics,
        )
        if plain != self._plain:
            checksum = f"{zlib.crc32(plain.model_dump_json().encode()):08x}"
            self._plain, self._config = plain, plain.model_copy(update={"config": checksum})
        return self._config

    def state(self, config: telemetry.ConfigReport) -> StateReport:
        """Return what changes all the time, to be read with `config`."""
        supervisor, bus, metrics, now_ns = self.supervisor, self.bus, self.events.metrics, self.events.clock()
        lease, buttons, lag = supervisor.lease, supervisor.buttons, metrics.loop_lag
        answered_ms = None if bus.answered_ns is None else max(0, now_ns - bus.answered_ns) / 1e6
        p50_us, p99_us = metrics.watchdog_stops.p50_p99_us()
        sources = tuple(dict.fromkeys(leg.source for leg in supervisor.legs if leg.source is not None))
        return StateReport(
            config=config.config,
            mode=supervisor.mode,
            time=wall_clock(),
            uptime_s=(now_ns - self._started_ns) / 1e9,
            legs=_legs(tuple(supervisor.legs), sources, now_ns),
            sources=sources,
            commands=telemetry.CommandCounts(
                accepted=metrics.accepted,
                rejected=metrics.rejected.total(),
                coalesced=metrics.coalesced,
                overflows=metrics.overflows,
                lost=metrics.lost,
            ),
            spi=telemetry.SpiCounts(frames=bus.frames, errors=bus.errors),
            watchdog=telemetry.WatchdogCounts(
                expirations=supervisor.watchdog.expirations,
                stop_latency_us=telemetry.StopLatency(p50=p50_us, p99=p99_us, max=metrics.watchdog_stops.max_us),
            ),
            estop=supervisor.latch.number,
            estop_source=self.events.estop_source,
            estop_since=self.estop_since,
            estop_fault=self.estop_fault,
            incident=self.events.recorder.incident,
            loop_lag_us=telemetry.LoopLag(p50=lag.at_most_us(0.5), p99=lag.at_most_us(0.99), max=lag.max_us),
            lease=telemetry.LeaseReport(
                holder=lease.holder,
                verified=lease.verified,
                held_s=None if lease.since_ns is None else (now_ns - lease.since_ns) / 1e9,
                expires_in_ms=None if lease.due_ns is None else max(0.0, (lease.due_ns - now_ns) / 1e6),
                asked_by=lease.asked_by,
            ),
            buttons=telemetry.ButtonsAlive(alive=buttons.alive, names=buttons.names),
            controller=telemetry.ControllerReport(alive=bus.controller_alive, age_ms=answered_ms),
            battery=None if self.newest is None else telemetry.Battery.model_validate(self.newest.values._asdict()),
            power=self.power(),
        ).fitted()


def limits_of(settings: Settings) -> telemetry.LimitsReport:
    """Return the settings' limits as the state reports them."""
    limits = settings.limits
    each = {name: limits.servos.get(name, ServoLimits()) for name in map(str, SERVO_IDS)}
    servos = {name: telemetry.ServoLimitsReport(**asdict(of_servo)) for name, of_servo in each.items()}
    return telemetry.LimitsReport(leg_rate_hz=limits.leg_rate_hz, max_age_ms=limits.max_age_ms, servos=servos)


def board_values(status: Status, now_ns: int) -> Mapping[str, Any]:
    """Return a power board's measurements by their names in `Telemetry`; empty before the first."""
    if status.answered_ns is None:
        return {}
    found: dict[str, Any] = {"age_ms": max(0, now_ns - status.answered_ns) / 1e6}
    if status.currents_ma:
        found["servos"] = {
            str(servo_id): telemetry.ServoTelemetry(supplied=servo_id in status.supplied, current_a=ma / 1000)
            for servo_id, ma in sorted(status.currents_ma.items())
        }
    rails = status.rails
    currents, volts = rails.get(power_board.STANDBY_SUPPLY_MA), rails.get(power_board.SUPPLY_BATTERY_MV)
    if currents is not None and volts is not None:
        found["supply"] = telemetry.Supply(voltage_v=volts[0] / 1000, current_a=currents[1] / 1000)
    converters = [rails.get(each) for each in _CONVERTERS]
    if None not in converters:
        found["converters_v"] = tuple(mv / 1000 for each in converters if each is not None for mv in each)
    temperatures_c = rails.get(power_board.TEMPERATURES_C)
    if temperatures_c is not None:
        found["board_temperatures_c"] = temperatures_c
    return found


def _legs(legs: Sequence[Leg], sources: Sequence[str], now_ns: int) -> LegsReport:
    angles = [[_deg(servo.angle_cdeg) for servo in leg.servos] for leg in legs]
    targets = [[_deg((servo.waiting or servo).angle_cdeg) for servo in leg.servos] for leg in legs]
    commanded = [leg.commanded_ns for leg in legs]
    return LegsReport.model_validate(
        {
            "watchdog": [leg.watchdog for leg in legs],
            "age_ms": [None if ns is None else round((now_ns - ns) / 1e6, 1) for ns in commanded],
            "angles_deg": angles,
            "targets_deg": None if targets == angles else targets,
            "source": [None if leg.source is None else sources.index(leg.source) for leg in legs],
        }
    )


def _deg(angle_cdeg: int | None) -> float | None:
    return None if angle_cdeg is None else angle_cdeg / 100
