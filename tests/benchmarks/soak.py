"""Soak: mixed traffic at ten times the real rate for an hour; memory, descriptors, threads and latency must not drift.

python -m tests.benchmarks.soak [--minutes 60]

The gateway runs as a user starts it, on the simulated controller. Four legs are sent 500 setpoints a second each, a
second program sends everything else (`soak_traffic`), and this one asks 100 acknowledged commands a second on leg 6,
whose answers, sent once the frame is handed to SPI, are the latencies shown. Machines change their pace within an hour,
so in the end a gateway that has just started is measured, too.
"""

import argparse
import statistics
import sys
import tempfile
import time
import urllib.request
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.client import Client, leg_payload
from gateway.errors import ZenohError
from schemas.keys import leg_command
from tests.benchmarks.processes import Figures, cpu_ns, fds, rss_kb, threads
from tests.benchmarks.subjects import program
from tests.support.gateway_process import Gateway, free_port

ASKS_HZ = 100
SAMPLE_S = 5.0
WARM_UP_S = 15.0
SLACK_KB = 2048
MAX_HOURS = 100


@dataclass(frozen=True, slots=True)
class Minute:
    """One minute's figures; memory and descriptors are medians of its samples, threads the fewest.

    Zenoh starts some for a visitor's link and ends them after a while, so only what never goes shows in the fewest.
    """

    latency: Figures
    unanswered: int
    rss_kb: float
    fds: float
    threads: int
    cpu_percent: float
    accepted: int
    rejected: int
    expirations: int

    def row(self, number: int) -> str:
        """One line of the table."""
        return (
            f"{number:4d} {self.latency.p50_us / 1000:8.2f} {self.latency.p99_us / 1000:8.2f}"
            f" {self.latency.max_us / 1000:8.1f} {self.unanswered:5d} {self.rss_kb / 1024:8.2f} {self.fds:5.0f}"
            f" {self.threads:5.0f} {self.cpu_percent:5.0f} {self.accepted:10d} {self.rejected:9d} {self.expirations:8d}"
        )


HEAD = (
    f"{'min':>4} {'p50 ms':>8} {'p99 ms':>8} {'max ms':>8} {'lost':>5} {'RSS MB':>8} {'fds':>5}"
    f" {'thr':>5} {'cpu %':>5} {'accepted':>10} {'rejected':>9} {'expired':>8}"
)


def one_minute(gateway: Gateway, client: Client, metrics: str, duration_s: float) -> Minute:
    """Ask for that long, and look at the process every few seconds."""
    pid = gateway.child.pid
    latencies_ns: list[int] = []
    unanswered = 0
    samples: list[tuple[int, int, int]] = []
    begun_s = due_s = sample_s = time.monotonic()
    begun_cpu_ns = cpu_ns(pid)
    while due_s < begun_s + duration_s:
        sent_ns = time.monotonic_ns()
        try:
            ack = client.ask(leg_command(6), leg_payload("start", (90, (due_s * 10) % 180, 90)))
            if ack.accepted:  # not between an emergency stop and its reset
                latencies_ns.append(time.monotonic_ns() - sent_ns)
        except ZenohError:
            unanswered += 1
        if time.monotonic() >= sample_s:
            samples.append((rss_kb(pid), fds(pid), threads(pid)))
            sample_s += SAMPLE_S
            with urllib.request.urlopen(f"http://{metrics}/metrics", timeout=5) as page:
                page.read()
        due_s = max(due_s + 1 / ASKS_HZ, time.monotonic())
        time.sleep(max(0.0, due_s - time.monotonic()))
    state = client.state()
    resident, descriptors, living = zip(*samples, strict=True)
    return Minute(
        Figures.of(latencies_ns),
        unanswered,
        statistics.median(resident),
        statistics.median(descriptors),
        min(living),
        (cpu_ns(pid) - begun_cpu_ns) / (time.monotonic() - begun_s) / 1e7,
        state.commands.accepted,
        state.commands.rejected,
        state.watchdog.expirations,
    )


def verdict(minutes: list[Minute]) -> str:
    """First minute against last, and whether that is flat."""
    first, last = minutes[0], minutes[-1]
    p99s = [minute.latency.p99_us / 1000 for minute in minutes]
    rows = [
        ("memory, MB", first.rss_kb / 1024, last.rss_kb / 1024, last.rss_kb <= first.rss_kb + SLACK_KB, "2 MB more"),
        ("file descriptors", first.fds, last.fds, last.fds <= first.fds, "no more"),
        ("threads", first.threads, last.threads, last.threads <= first.threads, "no more"),
        ("p99, ms", p99s[0], p99s[-1], p99s[-1] <= p99s[0], "no worse"),
        ("unanswered", first.unanswered, last.unanswered, sum(each.unanswered for each in minutes) == 0, "none ever"),
    ]
    lines = [f"{'':18} {'first':>9} {'last':>9}  aim"]
    for name, before, after, met, aim in rows:
        lines.append(f"{name:18} {before:9.2f} {after:9.2f}  {aim}: {'met' if met else 'NOT MET'}")
    lines.append(
        f"p99 over all minutes: {min(p99s):.2f} to {max(p99s):.2f} ms, median {statistics.median(p99s):.2f} ms;"
        f" {last.accepted} commands accepted, {last.rejected} rejected"
    )
    return "\n".join(lines)


class Traffic:
    """A gateway just started, and everything that is sent to it."""

    def __init__(self, stack: ExitStack) -> None:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        self._metrics = f"127.0.0.1:{free_port()}"
        settings: dict[str, dict[str, Any]] = {
            "limits": {"leg_rate_hz": 500.0},
            "watchdog": {"timeout_ms": 100.0},
            "telemetry": {"metrics": self._metrics},
        }
        self._gateway = stack.enter_context(Gateway(Path(folder), settings))
        self._client = stack.enter_context(self._gateway.client(source="soak"))
        stream = program("publisher", self._gateway.endpoint, "--legs", "1", "2", "3", "4", "--hz", "500")
        stack.callback(stream.close)
        stream.wait_for_output("ready")
        stream.tell(str(MAX_HOURS * 3600))
        others = program("soak_traffic", self._gateway.endpoint)
        stack.callback(others.close)
        self._programs = (self._gateway.child, stream, others)
        self.minute(WARM_UP_S)

    def minute(self, duration_s: float = 60.0) -> Minute:
        """The next one. Raises RuntimeError where one of the programs has ended before its time."""
        minute = one_minute(self._gateway, self._client, self._metrics, duration_s)
        for child in self._programs:
            if child.returncode is not None:
                raise RuntimeError(f"ended before its time: {child}")
        return minute


def main() -> None:
    """Run and report; the exit status says only whether the run came to its end."""
    parser = argparse.ArgumentParser(description="Run the gateway under mixed traffic and watch for drift.")
    parser.add_argument("--minutes", type=int, default=60)
    options = parser.parse_args()
    with ExitStack() as stack:
        traffic = Traffic(stack)
        print(HEAD, flush=True)
        minutes: list[Minute] = []
        for number in range(1, options.minutes + 1):
            print(f"\rminute {number} of {options.minutes} …", end="", file=sys.stderr, flush=True)
            minutes.append(traffic.minute())
            print(minutes[-1].row(number), flush=True)
    print("\ranother gateway, just started …", file=sys.stderr, flush=True)
    with ExitStack() as stack:
        fresh = Traffic(stack).minute()
    print(verdict(minutes), flush=True)
    print(f"p99 of a gateway just started, in the minute after: {fresh.latency.p99_us / 1000:.2f} ms", flush=True)


if __name__ == "__main__":
    main()
