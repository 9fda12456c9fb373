"""The service's numbers for Prometheus, over HTTP (`telemetry.metrics`).

One thread with its own loop answers, with at most MOST_A_SECOND connections a second. A thread for each connection
would delay Stops: its start and each of its system calls take the interpreter's lock, and one client that keeps
reconnecting started a thousand threads in a second.
"""

import asyncio
import logging
import socket
from collections.abc import Callable, Collection, Iterator, Mapping
from enum import StrEnum
from functools import partial
from http.client import parse_headers
from io import BytesIO
from itertools import accumulate
from threading import Thread
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from gateway import __version__
from gateway.errors import ConfigError
from gateway.host import logs
from gateway.host.realtime import PAGE_PRIORITY, prefer_thread
from gateway.robot.protocol.latency import BOUNDS_US, Latency
from gateway.robot.runtime.conductor import Conductor
from gateway.zenoh.endpoints import is_local
from schemas.gateway_state import PowerReport
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Telemetry
from schemas.words import Cause, Kind, Mode, Reason

METRICS_PATH: Final = "/metrics"
LOOPBACK: Final = frozenset({"localhost", "127.0.0.1", "::1"})
MOST_REQUESTS: Final = 8
"""Open at once. A Prometheus server needs one, a browser another."""
MOST_A_SECOND: Final = 25
"""Connections. A page takes 5 ms, so they take an eighth of a processor at most, at a low priority."""
WAITING: Final = 32
"""Connections that the kernel queues. They delay a scrape by 1.3 s at most; Prometheus waits ten seconds."""
REQUEST_S: Final = 5.0
"""A scrape takes 5 ms; Prometheus itself gives up after ten seconds."""
MAX_REQUEST_BYTES: Final = 8192
"""Prometheus sends about 300 bytes, a browser 1000."""
NO_DESCRIPTOR_S: Final = 0.5
"""Pause after an accept that failed because the process has no file descriptor left."""

T = TypeVar("T", bound=StrEnum)

logger = logging.getLogger(__name__)


class Numbers(Collector):
    """Reads the numbers at each scrape. It takes no lock, so it delays no Stop."""

    def __init__(self, conductor: Conductor) -> None:
        self._conductor = conductor

    def collect(self) -> Iterator[Metric]:
        conductor = self._conductor
        metrics, bus, reports, settings = conductor.metrics, conductor.bus, conductor.reports, conductor.settings
        supervisor, certificate, events = conductor.supervisor, reports.certificate, metrics.events
        lease, buttons, calibrating = supervisor.lease, supervisor.buttons, supervisor.calibrating
        holder = lease.holder  # read once: this thread does not own the state
        driving = None if holder is None else {"holder": holder, "verified": str(reports.names_proved).lower()}
        expiry = None if certificate is None else {certificate.file: certificate.expires.timestamp()}
        yield InfoMetricFamily("hexapod_build", "What runs", {"version": __version__, "protocol": settings.protocol})
        yield _gauge("sessions", "Zenoh sessions that are open", metrics.sessions)
        yield _counter("incidents", "Incidents that the black box has begun", conductor.recorder.incidents)
        yield _gauge("certificate_expiry_timestamp_seconds", "First expiry of a certificate in use", expiry, "file")
        yield _counter("commands_accepted", "Commands accepted", metrics.accepted)
        yield _counter("commands_coalesced", "Accepted commands that a newer one replaced", metrics.coalesced)
        yield _counter("overflows", "Times that messages of one key were lost before they were read", metrics.overflows)
        yield _counter("messages_lost", "Messages lost in overflows, at least", metrics.lost)
        yield _counter(
            "messages_passed_over", "Messages displaced by newer ones of their key", conductor.messages.passed_over
        )
        yield _counter("commands_rejected", "Commands rejected", _counts(metrics.rejected, Reason), "reason")
        yield _counter("frames_written", "Frames written to SPI", _counts(metrics.frames, Cause), "cause")
        yield _counter("spi_errors", "SPI transfers and openings that failed", bus.errors)
        yield _counter("watchdog_expirations", "Legs stopped for silence", supervisor.watchdog.expirations)
        yield _counter("log_lines_dropped", "Log lines not written, since their reader was too slow", logs.dropped())
        yield InfoMetricFamily("hexapod_lease", "The holder of the lease, or the client it is handed over to", driving)
        yield _counter("lease_changes", "What happened to the lease", _counts(events, Kind, "lease_"), "kind")
        yield _counter("button_changes", "What happened to stop buttons", _counts(events, Kind, "button_"), "kind")
        yield _gauge("buttons_alive", "Stop buttons that check in", buttons.alive)
        yield _gauge("buttons_required", "Stop buttons that must be alive to move", settings.buttons.required)
        yield _gauge("calibration_revision", "The calibration in force", calibrating.in_force.revision)
        yield _gauge("calibration_fault", "1: it cannot be read, and nothing starts", calibrating.fault is not None)
        yield _gauge("mode", "1 for the gateway's mode", {mode: mode is supervisor.mode for mode in Mode}, "mode")
        yield _histogram("watchdog_stop_latency", "Watchdog's deadline to its Stop written", metrics.watchdog_stops)
        yield _histogram("emergency_stop_latency", "Request to its sixth Stop written", metrics.emergency_stops)
        yield _histogram("loop_lag", "How late the loop's timers run", metrics.loop_lag)
        yield _histogram("spi_transfer", "Time of one SPI transfer", bus.transfer_latency)
        if settings.measures:
            battery = reports.battery()
            yield _gauge("battery_volts", "The battery's voltage", None if battery is None else battery.voltage_v)
        if settings.wire.measures:
            yield from _measured(conductor)
        power = reports.power()
        if power is not None:
            yield from powered(power, reports.measured(), events)


def _measured(conductor: Conductor) -> Iterator[Metric]:
    """Yield the robot's measurements and its controller's health; without values before the first measurement."""
    events, bus, newest = conductor.metrics.events, conductor.bus, conductor.reports.newest
    values, answered_ns = newest and newest[0], bus.answered_ns
    yield _gauge("battery_percent", "The battery's charge, as the robot reports it", values and values.percent)
    yield _gauge("temperature_celsius", "The temperature that the controller measures", values and values.temperature_c)
    yield _gauge("tilt_degrees", "Between the body's up and the world's", values and values.tilt_deg)
    yield _gauge("controller_alive", "1: the controller sends what it should", bus.controller_alive)
    age_s = None if answered_ns is None else (conductor.clock() - answered_ns) / 1e9
    yield _gauge("controller_answer_age_seconds", "Since the controller's last well-formed answer", age_s)
    feet = values and {str(leg): force for leg, force in zip(LEGS, values.feet, strict=True)}
    yield _gauge("foot_force", "The force on a foot, in the robot's own unit", feet, "leg")
    yield _counter("controller_changes", "What happened to it", _counts(events, Kind, "controller_"), "kind")
    yield _counter("falls", "Times that all legs were stopped since the body tilted too far", events[Kind.FALLEN])


def powered(power: PowerReport, measured: Telemetry | None, events: Mapping[Kind, int]) -> Iterator[Metric]:
    """Yield which servos the board powers, and the current of each; without values before the first measurement."""
    yield _gauge("power_alive", "1: the power board answers", power.alive)
    yield _gauge("power_confirmed", "1: the board has confirmed all offs that are asked of it", power.confirmed)
    age_s = None if power.age_ms is None else power.age_ms / 1000
    yield _gauge("power_answer_age_seconds", "Since the board last answered", age_s)
    supplied = {str(servo): servo in power.supplied for servo in SERVO_IDS}
    yield _gauge("servo_supplied", "1: the board fed this servo when it last reported it", supplied, "servo")
    servos = (measured and measured.servos) or {}
    drawn = {name: servo.current_a for name, servo in servos.items() if servo.current_a is not None}
    yield _gauge("servo_current_amperes", "What this servo draws", drawn, "servo")
    supply_v = None if measured is None or measured.supply is None else measured.supply.voltage_v
    yield _gauge("supply_volts", "The voltage of the servos' supply", supply_v)
    changes = _counts(events, Kind, ("power_", "servo_", "off_button"))
    yield _counter("power_changes", "What the power board reported, and what happened to it", changes, "kind")


def _counts(counter: Mapping[T, int], of: type[T], begins: str | tuple[str, ...] = "") -> Mapping[T, int]:
    return {each: counter[each] for each in of if each.startswith(begins)}


def _family(
    family: type[CounterMetricFamily | GaugeMetricFamily],
    name: str,
    help_text: str,
    numbers: float | Mapping[Any, float] | None,
    label: str = "",
) -> Metric:
    """Return a metric with a number, with one for each value of `label`, or with none."""
    if not isinstance(numbers, Mapping):
        return family(f"hexapod_{name}", help_text, None if numbers is None else float(numbers))
    found = family(f"hexapod_{name}", help_text, labels=[label])
    for value, number in numbers.items():
        found.add_metric([value], float(number))
    return found


_counter: Final = partial(_family, CounterMetricFamily)
_gauge: Final = partial(_family, GaugeMetricFamily)


def _histogram(name: str, help_text: str, latency: Latency) -> HistogramMetricFamily:
    bounds = [*(f"{bound_us / 1e6:g}" for bound_us in BOUNDS_US), "+Inf"]
    buckets = list(zip(bounds, map(float, accumulate(latency.buckets)), strict=True))
    return HistogramMetricFamily(f"hexapod_{name}_seconds", help_text, buckets, latency.sum_us / 1e6)


# ---- over HTTP


def serve(address: str, conductor: Conductor) -> None:
    """Serve the numbers at METRICS_PATH of `address` (`host:port`) from a thread of its own, until the process ends.

    Requests from other sites' pages get 403. A request may name that host, the loopback, this machine's host name (also
    with `.local`), or the address that it reached. Raises ConfigError if the address cannot be opened. May wait for a
    name server, so do not call it on the loop's thread.
    """
    registry = CollectorRegistry()
    registry.register(Numbers(conductor))
    ProcessCollector(registry=registry)
    host, _, port = address.rpartition(":")
    machine = socket.gethostname().lower()
    ours = {*LOOPBACK, host.strip("[]").lower(), machine, f"{machine.partition('.')[0]}.local"}
    try:
        family, kind, _, _, where = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(where)
        listening.listen(WAITING)
    except OSError as error:
        raise ConfigError(f"telemetry.metrics: {address} cannot be opened: {error.strerror or error}") from error
    listening.setblocking(False)

    def run() -> None:
        prefer_thread(PAGE_PRIORITY)
        asyncio.run(_accept(listening, partial(_response_to, partial(generate_latest, registry), ours)))

    Thread(target=run, name="metrics", daemon=True).start()
    if not is_local(f"tcp/{address}"):
        logger.warning("telemetry.metrics: anyone who reaches %s can read how the robot is used", address)


async def _accept(listening: socket.socket, response_to: Callable[[bytes, str], bytes]) -> None:
    loop, answering = asyncio.get_running_loop(), dict[asyncio.Task[None], None]()
    while True:
        try:
            connection, _ = await loop.sock_accept(listening)
        except OSError as error:
            logger.debug("no connection for metrics could be accepted: %s", error)
            await asyncio.sleep(NO_DESCRIPTOR_S)
            continue
        if len(answering) >= MOST_REQUESTS:
            next(iter(answering)).cancel()  # the oldest
        task = loop.create_task(_answer(connection, response_to))
        answering[task] = None
        task.add_done_callback(answering.pop)
        await asyncio.sleep(1 / MOST_A_SECOND)


async def _answer(connection: socket.socket, response_to: Callable[[bytes, str], bytes]) -> None:
    loop = asyncio.get_running_loop()
    try:
        with connection:
            connection.setblocking(False)
            async with asyncio.timeout(REQUEST_S):
                request = b""
                while b"\r\n\r\n" not in request:
                    more = await loop.sock_recv(connection, MAX_REQUEST_BYTES)
                    request += more
                    if not more or len(request) > MAX_REQUEST_BYTES:
                        return
                await loop.sock_sendall(connection, response_to(request, connection.getsockname()[0]))
    except Exception as error:
        logger.debug("a request for metrics failed", exc_info=error)


def _response_to(page: Callable[[], bytes], ours: Collection[str], request: bytes, reached: str) -> bytes:
    """`reached` is the address of ours that the client dialled; the socket may listen on all addresses."""
    first, _, rest = request.partition(b"\r\n")
    path, headers = first.decode("latin-1").split(" ")[1].partition("?")[0], parse_headers(BytesIO(rest))
    kind = "text/plain"
    if not may_ask(headers["Host"], headers["Origin"], {*ours, reached.removeprefix("::ffff:")}):
        status, body = "403 Forbidden", b"not under this name: ask by this machine's name or address\n"
    elif path != METRICS_PATH:
        status, body = "404 Not Found", f"the numbers are at {METRICS_PATH}\n".encode()
    else:
        status, kind, body = "200 OK", CONTENT_TYPE_LATEST, page()
    return f"HTTP/1.0 {status}\r\nContent-Type: {kind}\r\n\r\n".encode() + body


def may_ask(host: str | None, origin: str | None, ours: Collection[str]) -> bool:
    """Return whether a request comes from our own page, or from no page (`origin` is None).

    A page of another site can reach every port of its browser's machine. Its `origin` shows that; or, if one of its own
    names resolves to this machine (DNS rebinding), `host` does: a page cannot choose the Host header that its browser
    sends (`robot.local:9464`, `[::1]:9464`). The port is not compared, since a tunnel changes it.
    """
    return urlsplit(f"//{host or ''}").hostname in ours and (origin is None or origin == f"http://{host}")
