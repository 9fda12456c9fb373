"""The service's numbers for Prometheus, over HTTP (`telemetry.metrics`)."""

import logging
from collections.abc import Collection, Iterable, Iterator
from typing import TYPE_CHECKING, Final

from prometheus_client import CollectorRegistry, ProcessCollector, make_wsgi_app
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from gateway import __version__
from gateway.host import logs
from gateway.robot.core.latency import BOUNDS_US, Latency
from gateway.robot.protocol import VERSION
from gateway.robot.runtime.conductor import Conductor
from gateway.robot.runtime.metrics_page import MetricsPage
from gateway.robot.zenoh_io.exposure import is_local
from gateway.web_hosts import LOOPBACK, may_ask
from schemas.telemetry import Cause, Kind, Mode, Reason

METRICS_PATH: Final = "/metrics"

BUTTON_KINDS: Final = [kind for kind in Kind if kind.startswith("button_")]
LEASE_KINDS: Final = [kind for kind in Kind if kind.startswith("lease_")]

_PREFIX: Final = "hexapod"

if TYPE_CHECKING:
    from _typeshed.wsgi import StartResponse, WSGIApplication, WSGIEnvironment

logger = logging.getLogger(__name__)


class _Numbers(Collector):
    """Reads the numbers when asked; nothing is counted twice, and nobody waits for it: it takes no lock."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor

    def collect(self) -> Iterator[Metric]:
        metrics, bus = self._conductor.metrics, self._conductor.bus
        yield InfoMetricFamily(f"{_PREFIX}_build", "What runs", {"version": __version__, "protocol": VERSION})
        yield GaugeMetricFamily(f"{_PREFIX}_sessions", "Zenoh sessions that are open", metrics.sessions)
        yield GaugeMetricFamily(
            f"{_PREFIX}_older_ca_laptops",
            "Laptops that came with a certificate of the older of two CAs since the start",
            metrics.older_ca,
        )
        yield CounterMetricFamily(
            f"{_PREFIX}_incidents", "Incidents that the black box has begun", self._conductor.recorder.incidents
        )
        certificate = self._conductor.reports.certificate
        expiry = GaugeMetricFamily(
            f"{_PREFIX}_certificate_expiry_timestamp_seconds",
            "When the first of the certificates in use expires",
            labels=["file"],
        )
        if certificate is not None:
            expiry.add_metric([certificate.file], certificate.expires.timestamp())
        yield expiry
        yield CounterMetricFamily(f"{_PREFIX}_commands_accepted", "Commands accepted", metrics.accepted)
        yield CounterMetricFamily(
            f"{_PREFIX}_commands_coalesced", "Accepted commands that a newer one replaced", metrics.coalesced
        )
        yield CounterMetricFamily(
            f"{_PREFIX}_overflows", "Times that messages of one key were lost before they were read", metrics.overflows
        )
        yield CounterMetricFamily(f"{_PREFIX}_messages_lost", "Messages lost in these, at least", metrics.lost)
        rejected = CounterMetricFamily(f"{_PREFIX}_commands_rejected", "Commands rejected", labels=["reason"])
        for reason in Reason:
            rejected.add_metric([reason], metrics.rejected[reason])
        yield rejected
        frames = CounterMetricFamily(f"{_PREFIX}_frames_written", "Frames written to SPI", labels=["cause"])
        for cause in Cause:
            frames.add_metric([cause], metrics.frames[cause])
        yield frames
        yield CounterMetricFamily(f"{_PREFIX}_spi_errors", "SPI transfers and openings that failed", bus.errors)
        yield CounterMetricFamily(
            f"{_PREFIX}_watchdog_expirations", "Legs stopped for silence", self._conductor.supervisor.expirations
        )
        yield CounterMetricFamily(
            f"{_PREFIX}_log_lines_dropped",
            "Lines of the log that were not written, since nobody read it",
            logs.dropped(),
        )
        lease = self._conductor.supervisor.lease
        holder = InfoMetricFamily(f"{_PREFIX}_lease", "Who holds the lease, or to whom it is handed over")
        name = lease.holder  # read once: this thread owns nothing
        if name is not None:
            holder.add_metric([], {"holder": name, "verified": str(lease.verified).lower()})
        yield holder
        changes = CounterMetricFamily(f"{_PREFIX}_lease_changes", "What happened to the lease", labels=["kind"])
        for kind in LEASE_KINDS:
            changes.add_metric([kind], metrics.events[kind])
        yield changes
        buttons = self._conductor.supervisor.buttons
        yield GaugeMetricFamily(f"{_PREFIX}_buttons_alive", "Stop buttons that check in", buttons.alive)
        yield GaugeMetricFamily(f"{_PREFIX}_buttons_required", "How many must, for anything to move", buttons.required)
        changes = CounterMetricFamily(f"{_PREFIX}_button_changes", "What happened to stop buttons", labels=["kind"])
        for kind in BUTTON_KINDS:
            changes.add_metric([kind], metrics.events[kind])
        yield changes
        calibrating = self._conductor.supervisor.calibrating
        revision = calibrating.in_force.revision
        yield GaugeMetricFamily(f"{_PREFIX}_calibration_revision", "The calibration in force", revision)
        fault = float(calibrating.fault is not None)
        yield GaugeMetricFamily(f"{_PREFIX}_calibration_fault", "1: it cannot be read, and nothing starts", fault)
        modes = GaugeMetricFamily(f"{_PREFIX}_mode", "1 for the mode the gateway is in", labels=["mode"])
        for mode in Mode:
            modes.add_metric([mode], float(mode is self._conductor.supervisor.mode))
        yield modes
        yield _histogram("watchdog_stop_latency", "Watchdog's deadline to its Stop written", metrics.watchdog_stops)
        yield _histogram(
            "emergency_stop_latency", "Emergency stop received to its sixth Stop written", metrics.emergency_stops
        )
        yield _histogram("loop_lag", "How late the loop's timers run", metrics.loop_lag)
        yield _histogram("spi_transfer", "Time of one SPI transfer", bus.transfer_latency)


def _histogram(name: str, help_text: str, latency: Latency) -> HistogramMetricFamily:
    total = 0
    buckets = []
    for bound, count in zip([*(f"{bound_us / 1e6:g}" for bound_us in BOUNDS_US), "+Inf"], latency.buckets, strict=True):
        total += count
        buckets.append((bound, float(total)))
    return HistogramMetricFamily(f"{_PREFIX}_{name}_seconds", help_text, buckets, latency.sum_us / 1e6)


def _only_at_its_path(page: "WSGIApplication") -> "WSGIApplication":
    """The page at its path, and 404 everywhere else: prometheus_client answers with the numbers on any."""

    def answer(environ: "WSGIEnvironment", start_response: "StartResponse") -> Iterable[bytes]:
        if environ.get("PATH_INFO") == METRICS_PATH:
            return page(environ, start_response)
        start_response("404 Not Found", [("Content-Type", "text/plain")])
        return [f"the numbers are at {METRICS_PATH}\n".encode()]

    return answer


def _only_for(ours: Collection[str], page: "WSGIApplication") -> "WSGIApplication":
    """The page for requests under these hosts, or the address that they reached, and 403 for all others."""

    def answer(environ: "WSGIEnvironment", start_response: "StartResponse") -> Iterable[bytes]:
        known = {*ours, environ["SERVER_NAME"]}
        if may_ask(environ.get("HTTP_HOST"), environ.get("HTTP_ORIGIN"), known):
            return page(environ, start_response)
        start_response("403 Forbidden", [("Content-Type", "text/plain")])
        return [b"not under this name: telemetry.metrics_hosts lists more\n"]

    return answer


def serve(address: str, hosts: Collection[str], conductor: Conductor) -> None:
    """Serve the numbers on `host:port` from a thread of its own, also under the names in `hosts`.

    Raises ConfigError where the port cannot be had.

    May wait for a name server, so not for the loop's thread.
    """
    registry = CollectorRegistry()
    registry.register(_Numbers(conductor))
    ProcessCollector(registry=registry)
    ours = {*LOOPBACK, address.rpartition(":")[0].strip("[]").lower(), *map(str.lower, hosts)}
    MetricsPage(address, _only_for(ours, _only_at_its_path(make_wsgi_app(registry)))).start()
    if not is_local(f"tcp/{address}"):
        logger.warning("telemetry.metrics: anyone who reaches %s can read how the robot is used", address)
