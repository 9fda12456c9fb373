"""Publishes what the gateway does and knows: events, frame records, the state, the configuration and telemetry."""

import logging
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any, Final

from pydantic import BaseModel

from gateway import __version__
from gateway.host.settings_table import ServoLimits
from gateway.model import power_board
from gateway.model.elkapod import Measured
from gateway.model.telemetry import report_of
from gateway.rate_limit import RateLimitBySource
from gateway.robot.blackbox.recorder import LIMITED, Recorder, Written
from gateway.robot.core.events import Announce, Sender
from gateway.robot.core.intake import named_source
from gateway.robot.core.leg import Leg
from gateway.robot.core.message import Outbox, Received, Reply
from gateway.robot.core.supervisor import Supervisor
from gateway.robot.power.board import Status
from gateway.robot.power.line import PowerLine
from gateway.robot.protocol.latency import Latency
from gateway.robot.settings import Settings
from gateway.robot.spi import Wire
from schemas import keys
from schemas.config import (
    ButtonsConfig,
    CalibrationReport,
    CertificateReport,
    ConfigReport,
    LimitsReport,
    RevocationsReport,
    SpiConfig,
    TelemetryReport,
    WatchdogConfig,
    WireReport,
)
from schemas.event import Event, FrameRecord
from schemas.gateway_state import (
    ButtonsAlive,
    CommandCounts,
    ControllerReport,
    LeaseReport,
    LoopLag,
    PowerReport,
    SpiCounts,
    StopLatency,
    WatchdogCounts,
)
from schemas.robot import SERVO_IDS
from schemas.state import LegsReport, StateReport
from schemas.telemetry import Battery, ServoTelemetry, Supply, Telemetry
from schemas.words import Cause, Kind, Mode, Reason

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
        Kind.LEGS_STOPPED,
        *(kind for kind in Kind if kind.startswith("lease_")),
        Kind.CALIBRATED,
        Kind.BUTTON_REGISTERED,
        Kind.BUTTON_RETURNED,
        Kind.POWER_CUT,
        Kind.POWER_RESTORED,
    }
)
"""Kinds that are logged as information; the others are warnings."""

_CONVERTERS: Final = (power_board.CONVERTERS_1_TO_3_MV, power_board.CONVERTERS_4_5_MV)

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
class RobotReports:
    """Publishes the events and reports of one run. For the owner of the state."""

    settings: Settings
    supervisor: Supervisor
    bus: Wire
    line: PowerLine | None
    outbox: Outbox
    recorder: Recorder
    clock: Callable[[], int]
    """Returns the monotonic time in ns."""
    passed_over: Callable[[], int]
    """Returns how many messages newer ones of the same key have displaced. Asked for each state, not for each tick."""

    def __post_init__(self) -> None:
        self.metrics = Metrics()
        self.estop: Received | str | None = None
        """The latest emergency stop: its request, whose payload is parsed after its Stops, or its source."""
        self._allowances = {kind: RateLimitBySource(EVENTS_A_SECOND, EVENTS_AT_ONCE) for kind in LIMITED}
        self._started_ns = self.clock()
        limits, wire = self.settings.limits, self.settings.wire
        each = {str(servo): asdict(limits.servos.get(str(servo), ServoLimits())) for servo in SERVO_IDS}
        self._limits = LimitsReport.model_validate(
            {"leg_rate_hz": limits.leg_rate_hz, "max_age_ms": limits.max_age_ms, "servos": each}
        )
        can = wire.capabilities._replace(whole_robot=self.settings.starts_whole)
        self._wire = WireReport(name=wire.name, measures=wire.measures, supply_starts=wire.has_uart, **can._asdict())
        self.certificate: CertificateReport | None = None
        """The certificate in use that expires first, or None."""
        self.missing_endpoints: tuple[str, ...] = ()
        """The endpoints on which the gateway does not listen yet. Any thread may set it."""
        self.newest: tuple[Measured, int] | None = None
        """The controller's newest measurements, and when they were received (ns). They stay when it falls silent: their
        age shows that. Any thread may read them."""
        self.estop_since: datetime | None = None
        """When the emergency stop was engaged; None: it is not engaged."""
        self.estop_fault: str | None = None
        """Why the emergency stop may not outlast a restart, or counts as engaged."""
        self.revocations: RevocationsReport | None = None
        self.names_proved = False
        """Whether a certificate has to prove the name of a lease's holder."""
        self.simulated = False
        """Whether the controller is simulated."""
        self.physics: str | None = None
        """The Zenoh id of the process that simulates the robot's body, if there is one."""
        self.calibration_kept = False
        """Whether the next boot finds the calibration."""
        self._plain: ConfigReport | None = None
        """The newest configuration without its checksum, which takes as long as all the rest."""
        self._published: ConfigReport | None = None
        self.published_mode: Mode | None = None
        """The mode last published; None until the start is announced."""

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
        source = self.estop_source if kind is Kind.ESTOP_ENGAGED or what.cause is Cause.ESTOP else what.source
        limit = self._allowances.get(kind) if what.cause in (None, Cause.COMMAND) else None
        left_out = 0 if limit is None else limit.admit(source, self.clock())
        if left_out is None:
            return
        incident = self.recorder.event(what, source, left_out)
        extra = {
            "kind": kind, "source": source, "key": what.key, "reason": what.reason, "left_out": left_out or None,
            "legs": ",".join(map(str, what.legs)) or None, "incident": incident,
        }  # fmt: skip
        level = logging.INFO if kind in INFORMATIONAL else logging.WARNING
        if what.cause in (None, Cause.COMMAND):  # else the cause's own event is in the log
            logger.log(level, what.detail, extra=extra)
        event = Event(
            time=wall_clock(), kind=kind, source=source, key=what.key, reason=what.reason, detail=what.detail,
            left_out=left_out, legs=what.legs, incident=incident, source_id=what.source_id, cause=what.cause,
        )  # fmt: skip
        self.outbox.publish(keys.EVENT, event)

    def frames(self, written: Sequence[Written]) -> None:
        """Publish a step's frames, after the last was written."""
        for transmit, sent in written:
            record = FrameRecord(
                time=wall_clock(), monotonic_ns=sent.ns, bytes=transmit.frame.data.hex(), cause=transmit.cause
            )
            self.outbox.publish(keys.FRAME, record)

    def announce_start(self) -> None:
        """Publish that commands are accepted from now on."""
        self.announce(Announce(Kind.STARTED, f"hexapod-gateway {__version__} takes commands"))
        self.published_mode = Mode.STARTING
        self.publish_mode()

    def publish_mode(self) -> None:
        """Publish the state if its mode has changed."""
        mode = self.supervisor.mode
        if mode is not self.published_mode is not None:
            self.published_mode = mode
            self.recorder.mode(mode)
            logger.info("mode %s", mode)
            self.publish()

    def publish(self) -> None:
        """Publish the state. If the configuration has changed, publish that first."""
        config = self.config()
        if config != self._published:
            self._published = config
            self.outbox.publish(keys.CONFIG, config)
        self.outbox.publish(keys.STATE, self.state(config))

    def publish_telemetry(self) -> None:
        report = self.measured()
        if report is not None:
            self.outbox.publish(keys.TELEMETRY, report)

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

    def power(self) -> PowerReport | None:
        """Return the power board's report, or None without a board. For any thread."""
        if self.line is None:
            return None
        now_ns, status = self.clock(), self.line.status
        return PowerReport(
            interface=self.settings.power.interface,
            alive=status.alive,
            supplied=tuple(sorted(status.supplied)),
            confirmed=status.confirmed,
            age_ms=None if status.answered_ns is None else max(0, now_ns - status.answered_ns) / 1e6,
        )

    def battery(self) -> Battery | None:
        """Return the battery as measured, or None if it is unknown. For any thread."""
        if self.newest is not None:
            return Battery.model_validate(self.newest[0]._asdict())
        return None if self.line is None else board_values(self.line.status, 0).get("battery")

    def measured(self) -> Telemetry | None:
        """Return the measurements of the robot and its power board, or None without any. For any thread."""
        now_ns, time = self.clock(), wall_clock()
        found = {} if self.line is None else board_values(self.line.status, now_ns)
        newest = self.newest
        if newest is not None:
            values, measured_ns = newest
            age_ms = max(found.get("age_ms", 0.0), (now_ns - measured_ns) / 1e6)
            found = {**found, **{name: each for name, each in report_of(values, time, age_ms) if each is not None}}
        return Telemetry.model_validate({**found, "time": time}) if found else None

    def config(self) -> ConfigReport:
        """Return what seldom changes, with its checksum."""
        settings, calibrating = self.settings, self.supervisor.calibrating
        plain = ConfigReport(
            version=__version__,
            protocol=settings.protocol,
            simulated=self.simulated,
            spi=SpiConfig(
                device="simulated controller" if self.simulated else settings.device, framing=settings.framing
            ),
            watchdog=WatchdogConfig(timeout_ms=settings.watchdog.timeout_ms, landing_ms=settings.watchdog.landing_ms),
            buttons=ButtonsConfig(required=settings.buttons.required),
            calibration=CalibrationReport(
                revision=calibrating.in_force.revision, fault=calibrating.fault, kept=self.calibration_kept
            ),
            telemetry=TelemetryReport(frames=settings.telemetry.frames),
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

    def state(self, config: ConfigReport) -> StateReport:
        """Return what changes all the time, to be read with `config`."""
        supervisor, bus, metrics, now_ns = self.supervisor, self.bus, self.metrics, self.clock()
        lease, buttons, lag = supervisor.lease, supervisor.buttons, metrics.loop_lag
        answered_ms = None if bus.answered_ns is None else max(0, now_ns - bus.answered_ns) / 1e6
        p50_us, p99_us = metrics.watchdog_stops.p50_p99_us()
        senders = tuple(dict.fromkeys(leg.sender for leg in supervisor.legs if leg.sender[0] is not None))
        return StateReport(
            config=config.config,
            mode=supervisor.mode,
            time=wall_clock(),
            uptime_s=(now_ns - self._started_ns) / 1e9,
            legs=_legs(tuple(supervisor.legs), senders, now_ns),
            sources=tuple(name or "" for name, _ in senders),
            source_ids=tuple(source_id for _, source_id in senders),
            commands=CommandCounts(
                accepted=metrics.accepted,
                rejected=metrics.rejected.total(),
                coalesced=metrics.coalesced,
                overflows=metrics.overflows,
                lost=metrics.lost,
                passed_over=self.passed_over(),
            ),
            spi=SpiCounts(frames=bus.frames, errors=bus.errors),
            watchdog=WatchdogCounts(
                expirations=supervisor.watchdog.expirations,
                stop_latency_us=StopLatency(p50=p50_us, p99=p99_us, max=metrics.watchdog_stops.max_us),
            ),
            estop=supervisor.latch.number,
            estop_source=self.estop_source,
            estop_since=self.estop_since,
            estop_fault=self.estop_fault,
            incident=self.recorder.incident,
            loop_lag_us=LoopLag(p50=lag.at_most_us(0.5), p99=lag.at_most_us(0.99), max=lag.max_us),
            lease=LeaseReport(
                holder=lease.holder,
                verified=lease.holder is not None and self.names_proved,
                held_s=None if lease.since_ns is None else (now_ns - lease.since_ns) / 1e9,
                expires_in_ms=None if lease.due_ns is None else max(0.0, (lease.due_ns - now_ns) / 1e6),
                asked_by=lease.asked_by,
            ),
            buttons=ButtonsAlive(alive=buttons.alive, names=buttons.names),
            controller=ControllerReport(alive=bus.controller_alive, age_ms=answered_ms),
            battery=self.battery(),
            power=self.power(),
        ).fitted()


def board_values(status: Status, now_ns: int) -> Mapping[str, Any]:
    """Return a power board's measurements by their names in `Telemetry`; empty before the first."""
    if status.answered_ns is None:
        return {}
    found: dict[str, Any] = {"age_ms": max(0, now_ns - status.answered_ns) / 1e6}
    if status.currents_ma:
        found["servos"] = {
            str(servo_id): ServoTelemetry(supplied=servo_id in status.supplied, current_a=ma / 1000)
            for servo_id, ma in sorted(status.currents_ma.items())
        }
    rails = status.rails
    currents, volts = rails.get(power_board.STANDBY_SUPPLY_MA), rails.get(power_board.SUPPLY_BATTERY_MV)
    if volts is not None:
        found["battery"] = Battery(voltage_v=volts[1] / 1000, percent=None)
    if currents is not None and volts is not None:
        found["supply"] = Supply(voltage_v=volts[0] / 1000, current_a=currents[1] / 1000)
    converters = [rails.get(each) for each in _CONVERTERS]
    if None not in converters:
        found["converters_v"] = tuple(mv / 1000 for each in converters if each is not None for mv in each)
    temperatures_c = rails.get(power_board.TEMPERATURES_C)
    if temperatures_c is not None:
        found["board_temperatures_c"] = temperatures_c
    return found


def _legs(legs: Sequence[Leg], senders: Sequence[Sender], now_ns: int) -> LegsReport:
    angles = [[_deg(servo.angle_cdeg) for servo in leg.servos] for leg in legs]
    targets = [[_deg((servo.target or servo).angle_cdeg) for servo in leg.servos] for leg in legs]
    commanded = [leg.commanded_ns for leg in legs]
    return LegsReport.model_validate(
        {
            "watchdog": [leg.watchdog for leg in legs],
            "age_ms": [None if ns is None else round((now_ns - ns) / 1e6, 1) for ns in commanded],
            "angles_deg": angles,
            "targets_deg": None if targets == angles else targets,
            "source": [senders.index(leg.sender) if leg.sender in senders else None for leg in legs],
        }
    )


def _deg(angle_cdeg: int | None) -> float | None:
    return None if angle_cdeg is None else angle_cdeg / 100
