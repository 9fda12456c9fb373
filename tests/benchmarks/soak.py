"""Soak: mixed traffic at ten times the real rate for an hour; memory, descriptors, threads and latency must not drift.

    python -m tests.benchmarks.soak [--minutes 60]
    python -m tests.benchmarks.soak --traffic ENDPOINT      what else may reach a gateway, without end

The gateway runs as a user starts it, on the simulated controller. Four legs are sent 500 setpoints a second each, a
second program sends the lawful, the wrong, the silent and the sudden, and this one asks 100 acknowledged commands a
second on leg 6, whose answers are the latencies shown. Machines change their pace within an hour, so in the end a
gateway that has just started is measured, too.
"""

import argparse
import itertools
import json
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median, quantiles
from typing import Final, NamedTuple

from gateway.client import Client
from gateway.errors import ZenohError
from gateway.people.client.payloads import leg_payload, servo_payload
from schemas.keys import LEGS_COMMAND, leg_command, servo_command
from tests.benchmarks.processes import fds, program, publishing, rss_kb, threads
from tests.support.gateway_process import Gateway

ASKS_HZ: Final = 100
SAMPLES: Final = 12
WARM_UP_S: Final = 15.0
SLACK_MB: Final = 2


class Minute(NamedTuple):
    """One minute's figures; memory and descriptors are medians of its samples, threads the fewest.

    Zenoh starts some for a visitor's link and ends them after a while, so only what never goes shows in the fewest.
    """

    p50_ms: float
    p99_ms: float
    lost: int
    rss_mb: float
    fds: float
    threads: int


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
    p50_ms, p99_ms = (quantiles(latencies_ms, n=100, method="inclusive")[place] for place in (49, 98))
    resident, descriptors, living = zip(*samples, strict=True)
    return Minute(p50_ms, p99_ms, lost, median(resident) / 1024, median(descriptors), min(living))


@contextmanager
def measured() -> Iterator[Callable[[], Minute]]:
    """Start a gateway, and all that is sent to it; yield what measures the next minute."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        settings = {"limits": {"leg_rate_hz": 500.0}, "watchdog": {"timeout_ms": 100.0}}
        gateway = stack.enter_context(Gateway(folder, settings))
        client = stack.enter_context(gateway.client(source="soak"))
        legs = ("--legs", "1", "2", "3", "4", "--hz", "500")
        stream = stack.enter_context(publishing(gateway.endpoint, *legs))
        others = stack.enter_context(program("soak", "--traffic", gateway.endpoint))

        def minute(duration_s: float = 60.0) -> Minute:
            found = one_minute(gateway.child.pid, client, duration_s)
            for child in (gateway.child, stream, others):
                if child.returncode is not None:
                    raise RuntimeError(f"ended before its time: {child}")
            return found

        minute(WARM_UP_S)
        yield minute


# ---- the other traffic

FLOOD: Final = 10_000
"""Messages in one go."""
WRONG: Final[tuple[tuple[str, str | bytes], ...]] = (
    (leg_command(5), b"\xff\xfe\x00"),
    (leg_command(5), "[" * 4000),
    (leg_command(5), "x" * 5000),
    (leg_command(5), '{"servos":[{"op":"set","angle_deg":181},{"op":"stop"},{"op":"stop"}]}'),
    (servo_command(51), '{"op":"set","angle_deg":"90"}'),
    ("hexapod/leg/7/cmd", "{}"),
    ("hexapod/nonsense/cmd", "{}"),
)


def one_round(client: Client, number: int) -> None:
    """Send for a second; leg 5 falls silent at its end, so its watchdog has work."""

    def put(key: str, payload: object) -> None:
        client.session.put(key, json.dumps({"source": f"traffic-{number % 7}", **payload}))  # type: ignore[dict-item]

    for step in range(20):
        put(leg_command(5), leg_payload("start", (10.0 + step, 20.0, 30.0)))
        put(servo_command(51), servo_payload("set", 40.0 + step))
        time.sleep(0.005)
    put(LEGS_COMMAND, {"legs": {"4": leg_payload("set", (1, 2, 3)), "5": leg_payload("set", (4, 5, 6))}})
    for key, payload in WRONG:
        client.session.put(key, payload)
    client.session.put(leg_command(5), "{}", encoding="text/plain")
    client.session.delete(leg_command(5))
    if number % 5 == 0:
        put("hexapod/leg/*/cmd", leg_payload("stop"))
    if number % 10 == 3:
        client.reset(client.estop().estop, check=False)
    if number % 15 == 7:
        flood = json.dumps(leg_payload("start", (90.0, 90.0, 90.0)))
        for _ in range(FLOOD):
            client.session.put(leg_command(1), flood)


def traffic(endpoint: str) -> None:
    """Go on until killed; every other round a client connects, asks and leaves."""
    with Client(endpoint, source="traffic", timeout_s=5) as client:
        for number in itertools.count():
            begun_s = time.monotonic()
            one_round(client, number)
            if number % 2 == 0:
                with Client(endpoint, source=f"visitor-{number}", timeout_s=5) as visitor:
                    visitor.set_leg(3, 90, 90, 90, check=False)
            time.sleep(max(0.0, begun_s + 1.0 - time.monotonic()))


def main() -> None:
    """Run and report; the exit status says only whether the run came to its end."""
    parser = argparse.ArgumentParser(description="Run the gateway under mixed traffic and watch for drift.")
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--traffic", metavar="ENDPOINT", help="only send it what else may reach a gateway")
    options = parser.parse_args()
    if options.traffic:
        traffic(options.traffic)
    minutes: list[Minute] = []
    with measured() as next_minute:
        for number in range(options.minutes):
            minutes.append(next_minute())
            print(f"minute {number + 1}: {minutes[-1]}", flush=True)
    with measured() as next_minute:
        print(f"fresh: {next_minute()}")
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
