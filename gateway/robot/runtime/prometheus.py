"""The service's numbers for Prometheus, over HTTP (`telemetry.metrics`)."""

import logging
import socket
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, Final

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from gateway import __version__
from gateway.endpoints import is_local
from gateway.host import logs
from gateway.robot.protocol.latency import BOUNDS_US, Latency
from gateway.robot.runtime import metrics_page
from gateway.robot.runtime.conductor import Conductor
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Cause, Kind, Mode, PowerReport, Reason, Telemetry

_PREFIX: Final = "hexapod"

logger = logging.getLogger(__name__)


class Numbers(Collector):
    """Reads the numbers at each scrape. It takes no lock, so it delays no Stop."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor

    def collect(self) -> Iterator[Metric]:
        metrics, bus, recorder = self._conductor.metrics, self._conductor.bus, self._conductor.recorder
        supervisor, reports = self._conductor.supervisor, self._conductor.reports
        certificate = reports.certificate
        lease, buttons, calibrating = supervisor.lease, supervisor.buttons, supervisor.calibrating
        yield InfoMetricFamily(f"{_PREFIX}_build", "What runs", {"version": __version__, "protocol": reports.protocol})
        yield _gauge("sessions", "Zenoh sessions that are open", metrics.sessions)
        yield _counter("incidents", "Incidents that the black box has begun", recorder.incidents)
        yield _gauge(
            "certificate_expiry_timestamp_seconds",
            "When the first of the certificates in use expires",
            {} if certificate is None else {certificate.file: certificate.expires.timestamp()},
            "file",
        )
        yield _counter("commands_accepted", "Commands accepted", metrics.accepted)
        yield _counter("commands_coalesced", "Accepted commands that a newer one replaced", metrics.coalesced)
        yield _counter("overflows", "Times that messages of one key were lost before they were read", metrics.overflows)
        yield _counter("messages_lost", "Messages lost in overflows, at least", metrics.lost)
        rejected = {reason: metrics.rejected[reason] for reason in Reason}
        yield _counter("commands_rejected", "Commands rejected", rejected, "reason")
        frames = {cause: metrics.frames[cause] for cause in Cause}
        yield _counter("frames_written", "Frames written to SPI", frames, "cause")
        yield _counter("spi_errors", "SPI transfers and openings that failed", bus.errors)
        yield _counter("watchdog_expirations", "Legs stopped for silence", supervisor.watchdog.expirations)
        yield _counter(
            "log_lines_dropped", "Log lines not written, since stdout or stderr was not read", logs.dropped()
        )
        holder = InfoMetricFamily(
            f"{_PREFIX}_lease", "The holder of the lease, or the client that it is handed over to"
        )
        name = lease.holder  # read once: this thread does not own the state
        if name is not None:
            holder.add_metric([], {"holder": name, "verified": str(lease.verified).lower()})
        yield holder
        for of, what in (("lease", "the lease"), ("button", "stop buttons")):
            kinds = {kind: metrics.events[kind] for kind in Kind if kind.startswith(f"{of}_")}
            yield _counter(f"{of}_changes", f"What happened to {what}", kinds, "kind")
        yield _gauge("buttons_alive", "Stop buttons that check in", buttons.alive)
        yield _gauge("buttons_required", "Stop buttons that must be alive for anything to move", buttons.required)
        yield _gauge("calibration_revision", "The calibration in force", calibrating.in_force.revision)
        yield _gauge(
            "calibration_fault", "1: the calibration cannot be read, and nothing starts", calibrating.fault is not None
        )
        modes = {mode: mode is supervisor.mode for mode in Mode}
        yield _gauge("mode", "1 for the mode the gateway is in", modes, "mode")
        yield _histogram("watchdog_stop_latency", "Watchdog's deadline to its Stop written", metrics.watchdog_stops)
        yield _histogram(
            "emergency_stop_latency", "Emergency stop received to its sixth Stop written", metrics.emergency_stops
        )
        yield _histogram("loop_lag", "How late the loop's timers run", metrics.loop_lag)
        yield _histogram("spi_transfer", "Time of one SPI transfer", bus.transfer_latency)
        if reports.measures:
            yield from _measured(self._conductor)
        power = self._conductor.telemetry.power()
        if power is not None:
            yield from powered(power, self._conductor.telemetry.report(), metrics.events)


def _measured(conductor: Conductor) -> Iterator[Metric]:
    """Yield the robot's measurements and its controller's health; without values before the first measurement."""
    events, alive, telemetry = conductor.metrics.events, conductor.bus.controller_alive, conductor.telemetry
    values = telemetry.newest and telemetry.newest.values
    answered_ns = conductor.bus.answered_ns
    age_s = None if answered_ns is None else (conductor.clock() - answered_ns) / 1e9
    for name, help_text, number in (
        ("battery_volts", "The battery's voltage", values and values.voltage_v),
        ("battery_percent", "The battery's charge, as the robot reports it", values and values.percent),
        ("temperature_celsius", "The temperature that the controller measures", values and values.temperature_c),
        ("tilt_degrees", "Between the body's up and the world's", values and values.tilt_deg),
        ("controller_alive", "1: the controller sends what it should", alive),
        ("controller_answer_age_seconds", "Since the controller's last well-formed answer", age_s),
    ):
        yield _gauge(name, help_text, {} if number is None else number)
    feet = {} if values is None else {str(leg): force for leg, force in zip(LEGS, values.feet, strict=True)}
    yield _gauge("foot_force", "The force on a foot, in the robot's own unit", feet, "leg")
    yield _counter(
        "controller_changes",
        "What happened to the controller",
        {kind: events[kind] for kind in (Kind.CONTROLLER_SILENT, Kind.CONTROLLER_RESTARTED, Kind.CONTROLLER_RETURNED)},
        "kind",
    )
    yield _counter("falls", "Times that all legs were stopped since the body tilted too far", events[Kind.FALLEN])


POWER_CHANGES: Final = tuple(kind for kind in Kind if kind.startswith(("power_", "servo_")) or kind == Kind.OFF_BUTTON)


def powered(power: PowerReport, measured: Telemetry | None, events: Mapping[Kind, int]) -> Iterator[Metric]:
    """Yield which servos the board powers, and the current of each; without values before the first measurement."""
    yield _gauge("power_alive", "1: the power board answers", power.alive)
    yield _gauge("power_confirmed", "1: the board has confirmed all offs that are asked of it", power.confirmed)
    yield _gauge(
        "power_answer_age_seconds", "Since the board last answered", {} if power.age_ms is None else power.age_ms / 1000
    )
    supplied = {str(servo): servo in power.supplied for servo in SERVO_IDS}
    yield _gauge("servo_supplied", "1: the board fed this servo when it last reported it", supplied, "servo")
    servos = {} if measured is None else measured.servos or {}
    drawn = {name: servo.current_a for name, servo in servos.items() if servo.current_a is not None}
    yield _gauge("servo_current_amperes", "What this servo draws", drawn, "servo")
    supply = None if measured is None else measured.supply
    yield _gauge("supply_volts", "The voltage of the servos' supply", {} if supply is None else supply.voltage_v)
    kinds = {kind: events[kind] for kind in POWER_CHANGES}
    yield _counter("power_changes", "What the power board reported, and what happened to it", kinds, "kind")


def _family(
    family: type[CounterMetricFamily | GaugeMetricFamily],
    name: str,
    help_text: str,
    numbers: float | Mapping[Any, float],
    label: str = "",
) -> Metric:
    if not isinstance(numbers, Mapping):
        return family(f"{_PREFIX}_{name}", help_text, float(numbers))
    found = family(f"{_PREFIX}_{name}", help_text, labels=[label])
    for value, number in numbers.items():
        found.add_metric([value], float(number))
    return found


_counter: Final = partial(_family, CounterMetricFamily)
_gauge: Final = partial(_family, GaugeMetricFamily)


def _histogram(name: str, help_text: str, latency: Latency) -> HistogramMetricFamily:
    total = 0
    buckets = []
    for bound, count in zip([*(f"{bound_us / 1e6:g}" for bound_us in BOUNDS_US), "+Inf"], latency.buckets, strict=True):
        total += count
        buckets.append((bound, float(total)))
    return HistogramMetricFamily(f"{_PREFIX}_{name}_seconds", help_text, buckets, latency.sum_us / 1e6)


def serve(address: str, conductor: Conductor) -> None:
    """Serve the numbers on `address` (`host:port`) from a thread of its own.

    A request may name that host, the loopback, or this machine's host name (also with `.local`). Raises ConfigError if
    the address cannot be opened. May wait for a name server, so do not call it on the loop's thread.
    """
    registry = CollectorRegistry()
    registry.register(Numbers(conductor))
    ProcessCollector(registry=registry)
    machine = socket.gethostname().lower()
    ours = {address.rpartition(":")[0].strip("[]").lower(), machine, f"{machine.partition('.')[0]}.local"}
    metrics_page.serve(address, partial(generate_latest, registry), ours)
    if not is_local(f"tcp/{address}"):
        logger.warning("telemetry.metrics: anyone who reaches %s can read how the robot is used", address)
