"""The service's numbers for Prometheus, over HTTP (`telemetry.metrics`)."""

import logging
import socket
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from socketserver import TCPServer, ThreadingMixIn
from threading import BoundedSemaphore, Lock, Thread
from typing import TYPE_CHECKING, Any, Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

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
from gateway.core.latency import BOUNDS_US, Latency
from gateway.edge.exposure import is_local
from gateway.errors import ConfigError
from gateway.host import logs
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.protocol import VERSION
from gateway.runtime.conductor import Conductor
from schemas.telemetry import Cause, Kind, Mode, Reason

MOST_REQUESTS: Final = 8
"""At once: one Prometheus needs one, and a person who looks another."""
REQUEST_S: Final = 5.0
"""A scrape takes 5 ms; Prometheus itself gives up after ten seconds."""

METRICS_PATH: Final = "/metrics"

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
        yield CounterMetricFamily(
            f"{_PREFIX}_incidents", "Incidents that the black box has begun", self._conductor.recorder.incidents
        )
        certificate = self._conductor.certificate
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
            changes.add_metric([kind], lease.changes[kind])
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


class _Server(ThreadingMixIn, WSGIServer):
    """A thread for each request, and not too many of either: whoever connects and says nothing makes room for others.

    prometheus_client's own server starts a thread for each connection and waits for its request for ever, so that
    connections alone use up the threads and descriptors of the service.
    """

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, address: str, registry: CollectorRegistry) -> None:
        host, _, port = address.rpartition(":")
        family, *_, where = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
        self.address_family = family
        self._lock = Lock()  # only the threads here take it
        self._begun_s: dict[socket.socket, float] = {}
        self._free = BoundedSemaphore(MOST_REQUESTS)
        super().__init__((str(where[0]), int(where[1])), _Request)
        self.set_app(_only_at_its_path(make_wsgi_app(registry)))

    def server_bind(self) -> None:
        # Not as HTTPServer does, which asks the network for this machine's full name, and nobody here wants that.
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])
        self.setup_environ()

    def serve_forever(self, poll_interval: float = 0.5) -> None:
        prefer_thread(PAGE_PRIORITY)
        super().serve_forever(poll_interval)

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._lock:
            if len(self._begun_s) >= MOST_REQUESTS:
                _hang_up(next(iter(self._begun_s)))  # the oldest, whose thread then ends
        self._free.acquire()
        with self._lock:
            self._begun_s[request] = time.monotonic()
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        prefer_thread(PAGE_PRIORITY)
        super().process_request_thread(request, client_address)

    def service_actions(self) -> None:
        """Twice a second: end what takes too long, such as a request that comes byte by byte."""
        late_s = time.monotonic() - REQUEST_S
        with self._lock:
            for request, begun_s in self._begun_s.items():
                if begun_s < late_s:
                    _hang_up(request)

    def shutdown_request(self, request: Any) -> None:
        with self._lock:
            known = self._begun_s.pop(request, None) is not None
            super().shutdown_request(request)
        if known:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        del request
        logger.debug("a request for metrics from %s failed", client_address, exc_info=True)


def _only_at_its_path(page: "WSGIApplication") -> "WSGIApplication":
    """The page at its path, and 404 everywhere else: prometheus_client answers with the numbers on any."""

    def answer(environ: "WSGIEnvironment", start_response: "StartResponse") -> Iterable[bytes]:
        if environ.get("PATH_INFO") == METRICS_PATH:
            return page(environ, start_response)
        start_response("404 Not Found", [("Content-Type", "text/plain")])
        return [f"the numbers are at {METRICS_PATH}\n".encode()]

    return answer


def _hang_up(request: socket.socket) -> None:
    with suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


class _Request(WSGIRequestHandler):
    def log_message(self, *_: object) -> None:
        """Log nothing."""


def serve(address: str, conductor: Conductor) -> None:
    """Serve the numbers on `host:port` from threads of their own. Raises ConfigError where the port cannot be had.

    May wait for a name server, so not for the loop's thread.
    """
    registry = CollectorRegistry()
    registry.register(_Numbers(conductor))
    ProcessCollector(registry=registry)
    try:
        server = _Server(address, registry)
    except OSError as error:
        raise ConfigError(f"telemetry.metrics: {address} cannot be opened: {error.strerror or error}") from error
    Thread(target=server.serve_forever, name="metrics", daemon=True).start()
    if not is_local(f"tcp/{address}"):
        logger.warning("telemetry.metrics: anyone who reaches %s can read how the robot is used", address)
