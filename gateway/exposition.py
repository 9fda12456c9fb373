"""The service's numbers for Prometheus, over HTTP (`telemetry.metrics`)."""

from collections.abc import Iterator
from threading import Thread
from typing import Final
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, ProcessCollector, start_http_server
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from gateway import logs
from gateway.conductor import Conductor
from gateway.errors import ConfigError
from gateway.latency import BOUNDS_US, Latency
from gateway.realtime import PAGE_PRIORITY, prefer_thread
from schemas.telemetry import Cause, Mode, Reason

_PREFIX: Final = "hexapod"


class _Numbers(Collector):
    """Reads the numbers when asked; nothing is counted twice, and the loop pays nothing for it."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor

    def collect(self) -> Iterator[Metric]:
        prefer_thread(PAGE_PRIORITY)  # each request has a thread of its own
        metrics, bus = self._conductor.metrics, self._conductor.bus
        yield CounterMetricFamily(f"{_PREFIX}_commands_accepted", "Commands accepted", metrics.accepted)
        yield CounterMetricFamily(
            f"{_PREFIX}_commands_coalesced", "Accepted commands that a newer one replaced", metrics.coalesced
        )
        rejected = CounterMetricFamily(f"{_PREFIX}_commands_rejected", "Commands refused", labels=["reason"])
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


def serve(address: str, conductor: Conductor) -> tuple[WSGIServer, Thread]:
    """Serve the numbers on `host:port` from a thread of its own. Raises ConfigError where the port cannot be had."""
    host, _, port = address.rpartition(":")
    registry = CollectorRegistry()
    registry.register(_Numbers(conductor))
    ProcessCollector(registry=registry)
    try:
        return start_http_server(int(port), addr=host.strip("[]"), registry=registry)
    except OSError as error:
        raise ConfigError(f"telemetry.metrics: {address} cannot be opened: {error.strerror or error}") from error
