"""Soak: mixed traffic at ten times the real rate for an hour; memory, descriptors, threads and latency must not drift.

python -m tests.benchmarks.soak [--minutes 60]

The gateway runs as a user starts it, on the simulated controller. Four legs are sent 500 setpoints a second each, a
second program sends everything else (`soak_traffic`), and this one asks 100 acknowledged commands a second on leg 6,
whose answers are the latencies shown. Machines change their pace within an hour, so in the end a gateway that has just
started is measured, too.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from gateway.client import Client, leg_payload
from gateway.errors import ZenohError
from gateway.robot.protocol.latency import percentile
from schemas.keys import leg_command
from tests.benchmarks.processes import fds, program, rss_kb, threads
from tests.support.gateway_process import Gateway

ASKS_HZ: Final = 100
SAMPLES: Final = 12
WARM_UP_S: Final = 15.0
SLACK_MB: Final = 2
MAX_HOURS: Final = 100
HEAD: Final = "minute  p50 ms  p99 ms  max ms  lost  RSS MB  fds  threads  accepted  expired"


class Minute(NamedTuple):
    """One minute's figures; memory and descriptors are medians of its samples, threads the fewest.

    Zenoh starts some for a visitor's link and ends them after a while, so only what never goes shows in the fewest.
    """

    p50_ms: float
    p99_ms: float
    max_ms: float
    lost: int
    rss_mb: float
    fds: float
    threads: int
    accepted: int
    expired: int


def one_minute(pid: int, client: Client, duration_s: float) -> Minute:
    """Ask for that long, and look at the process every few seconds."""
    latencies_ms: list[float] = []
    lost = 0
    samples: list[tuple[int, int, int]] = []
    for part in range(SAMPLES):
        due_s = end_s = time.monotonic()
        end_s += duration_s / SAMPLES
        while due_s < end_s:
            sent_ns = time.monotonic_ns()
            try:
                if client.ask(leg_command(6), leg_payload("start", (90, (part * 10) % 180, 90))).accepted:
                    latencies_ms.append((time.monotonic_ns() - sent_ns) / 1e6)
            except ZenohError:
                lost += 1
            due_s = max(due_s + 1 / ASKS_HZ, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))
        samples.append((rss_kb(pid), fds(pid), threads(pid)))
    latencies_ms.sort()
    state = client.state()
    resident, descriptors, living = zip(*samples, strict=True)
    return Minute(
        p50_ms=percentile(latencies_ms, 0.5),
        p99_ms=percentile(latencies_ms, 0.99),
        max_ms=latencies_ms[-1],
        lost=lost,
        rss_mb=statistics.median(resident) / 1024,
        fds=statistics.median(descriptors),
        threads=min(living),
        accepted=state.commands.accepted,
        expired=state.watchdog.expirations,
    )


@contextmanager
def traffic() -> Iterator[Callable[[], Minute]]:
    """A gateway just started, and everything that is sent to it; yields what measures the next minute."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        settings = {"limits": {"leg_rate_hz": 500.0}, "watchdog": {"timeout_ms": 100.0}}
        gateway = stack.enter_context(Gateway(folder, settings))
        client = stack.enter_context(gateway.client(source="soak"))
        legs = ("--legs", "1", "2", "3", "4", "--hz", "500")
        stream = stack.enter_context(program("publisher", gateway.endpoint, *legs))
        stream.wait_for_output("ready")
        stream.tell(str(MAX_HOURS * 3600))
        others = stack.enter_context(program("soak_traffic", gateway.endpoint))

        def minute(duration_s: float = 60.0) -> Minute:
            found = one_minute(gateway.child.pid, client, duration_s)
            for child in (gateway.child, stream, others):
                if child.returncode is not None:
                    raise RuntimeError(f"ended before its time: {child}")
            return found

        minute(WARM_UP_S)
        yield minute


def row(name: str | int, minute: Minute) -> str:
    return f"{name:>6}" + "".join(f"  {value:.2f}" if isinstance(value, float) else f"  {value}" for value in minute)


def main() -> None:
    """Run and report; the exit status says only whether the run came to its end."""
    parser = argparse.ArgumentParser(description="Run the gateway under mixed traffic and watch for drift.")
    parser.add_argument("--minutes", type=int, default=60)
    options = parser.parse_args()
    print(HEAD, flush=True)
    minutes: list[Minute] = []
    with traffic() as next_minute:
        for number in range(options.minutes):
            minutes.append(next_minute())
            print(row(number + 1, minutes[-1]), flush=True)
    with traffic() as next_minute:
        print(row("fresh", next_minute()))
    first, last = minutes[0], minutes[-1]
    for name, met in (
        ("memory: at most 2 MB more", last.rss_mb <= first.rss_mb + SLACK_MB),
        ("file descriptors: no more", last.fds <= first.fds),
        ("threads: no more", last.threads <= first.threads),
        ("p99: no worse", last.p99_ms <= first.p99_ms),
        ("unanswered: none", not any(each.lost for each in minutes)),
    ):
        print(f"{name}: {'met' if met else 'NOT MET'}")


if __name__ == "__main__":
    main()
