"""The benchmark: this gateway beside the naive script, in one run, on emulated SPI devices.

    python -m tests.benchmarks [--quick] [--only PART] [--release FOLDER]

What a setpoint costs is in duel.py. All other parts run on the emulated device of the tests. A message carries its
number in its angles, so that a transfer is matched with the moment when its message was published; all clocks are the
machine's one monotonic clock.
"""

import argparse
import math
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from schemas.keys import leg_command
from tests.benchmarks.duel import duel
from tests.benchmarks.processes import Figures, cpu_ns, now_ns, rss_kb, say, sixth_stop_us
from tests.benchmarks.publisher import number_of
from tests.benchmarks.subjects import Subject
from tests.benchmarks.table import Row, as_text, microseconds
from tests.benchmarks.wildcards import wildcards
from tests.hil.bed import missing_packages

SETPOINTS = "setpoints"
FLOOD_S = 3.0


@dataclass(frozen=True, slots=True)
class _Flooded:
    """A flood of leg 1 with leg 2 at 50 Hz beside it: the ages of both legs' frames, and how many leg 1 was sent."""

    ages: tuple[Figures | None, Figures | None]
    rate_hz: float
    stops_us: list[float | None]


def _flood(subject: Subject) -> tuple[tuple[Figures | None, Figures | None], float]:
    flood = subject.publisher("--legs", "1", "--hz", "0")
    other = subject.publisher("--legs", "2", "--hz", "50")
    begun_ns = now_ns()
    other.start(FLOOD_S)
    flood.start(FLOOD_S)
    offered = flood.wait()
    other.wait()
    end_ns = begun_ns + round(FLOOD_S * 1e9)
    time.sleep(1.0)
    # What comes late counts too: a frame of the backlog is no better for having been written after the flood.
    written = subject.device.written(begun_ns)
    say(f"  {offered / FLOOD_S:,.0f} messages a second were offered")
    flooded = [each for each in written if number_of(each.data) is not None and each.data[2] // 10 == 1]
    ages = [publisher.latencies_ns(written) for publisher in (flood, other)]
    first, second = (Figures.of(each) if each else None for each in ages)
    return (first, second), sum(each.monotonic_ns < end_ns for each in flooded) / FLOOD_S


def _age(figures: Figures | None) -> str:
    return "none came" if figures is None else f"{microseconds(figures.p99_us)} (p50 {microseconds(figures.p50_us)})"


@dataclass(frozen=True, slots=True)
class Latest:
    """The worst of some stops; infinite where one did not come while anybody looked."""

    worst_us: float

    @classmethod
    def of(cls, stops_us: list[float | None]) -> Self:
        return cls(max(math.inf if stop_us is None else stop_us for stop_us in stops_us))

    @property
    def text(self) -> str:
        return "not until after the flood" if math.isinf(self.worst_us) else microseconds(self.worst_us)


def _stops_in_flood(subject: Subject) -> list[float | None]:
    """Emergency stops during a flood, request → sixth Stop on the wire, in µs; None: not before the flood had ended."""
    flood = subject.publisher("--legs", "1", "--hz", "0")
    robot = subject.client()
    flood.start(FLOOD_S)
    time.sleep(0.4)
    requests: list[int] = []
    for _ in range(8 if subject.name == "gateway" else 1):
        requests.append(now_ns())
        if subject.name == "gateway":
            robot.estop()
            time.sleep(0.15)
            robot.reset()
            time.sleep(0.1)
        else:  # it knows no emergency stop: six legs are stopped one by one
            for leg in range(1, 7):
                robot.publish(leg_command(leg), {"servos": [{"op": "stop"}] * 3})
    flood.wait()
    time.sleep(1.0)
    written = subject.device.written()
    return [sixth_stop_us(written, requested_ns) for requested_ns in requests]


def flood(folder: Path) -> list[Row]:
    """One leg is sent as much as one publisher can."""
    found = []
    for name in ("gateway", "naive"):
        say(f"flood of one leg: {name}")
        with ExitStack() as stack:
            ages, rate_hz = _flood(Subject(name, folder, stack))
        with ExitStack() as stack:
            found.append(_Flooded(ages, rate_hz, _stops_in_flood(Subject(name, folder, stack))))
    ours, naive = found
    stops = Latest.of(ours.stops_us)
    rows = [
        Row(f"flood of one leg: {what}, p99", _age(ours.ages[leg]), _age(naive.ages[leg]), f"at most {aim_ms} ms", met)
        for leg, what, aim_ms in ((0, "age of its frames", 8), (1, "another leg at 50 Hz", 10))
        for figures in [ours.ages[leg]]
        for met in [figures is not None and figures.p99_us <= aim_ms * 1000]
    ]
    return [
        *rows,
        Row(
            f"flood of one leg: emergency stop → sixth Stop, worst of {len(ours.stops_us)}",
            stops.text,
            f"{Latest.of(naive.stops_us).text} (six Stops)",
            "at most 5 ms",
            stops.worst_us <= 5_000,
        ),
        Row(
            "flood of one leg: frames a second for it",
            f"{ours.rate_hz:.1f}",
            f"{naive.rate_hz:,.0f}",
            "at most 50",
            # And the three rate slots that its bucket held.
            ours.rate_hz <= 50 + 3 / FLOOD_S + 0.01,
        ),
    ]


def idle(folder: Path) -> list[Row]:
    """Nobody commands anything."""
    with ExitStack() as stack:
        subjects = [Subject(name, folder, stack) for name in ("gateway", "naive")]
        say("idle for 5 s")
        time.sleep(1)
        begun_ns, begun = now_ns(), [cpu_ns(subject.pid) for subject in subjects]
        time.sleep(5)
        elapsed_ns = now_ns() - begun_ns
        ours, naive = (
            100 * (cpu_ns(subject.pid) - before_ns) / elapsed_ns
            for subject, before_ns in zip(subjects, begun, strict=True)
        )
    return [Row("idle: CPU, share of one core", f"{ours:.2f} %", f"{naive:.2f} %", "at most 0.3 %", ours <= 0.3)]


def memory(folder: Path) -> list[Row]:
    """A million commands, none lost on the way to the process."""
    with ExitStack() as stack:
        return _memory(Subject("gateway", folder, stack))


def _memory(subject: Subject) -> list[Row]:
    publisher = subject.publisher("--legs", "1", "2", "3", "--hz", "0", "--block")
    count, early_count, early_kb, run_s = 0, 0, 0, 0.02
    robot = subject.client()
    deadline_s = time.monotonic() + 60
    while count < 1_000_000 and time.monotonic() < deadline_s:
        count += publisher.run(run_s)
        if not early_kb and count >= 10_000:
            early_count, early_kb, run_s = count, rss_kb(subject.pid), 2.0
        say(f"memory: {count:,} commands")
    state = robot.state()
    late_kb = rss_kb(subject.pid)
    return [
        Row(
            f"memory after {early_count:,} and after {count:,} commands",
            f"{early_kb / 1024:.1f} and {late_kb / 1024:.1f} MB ({state.commands.accepted:,} got past the rings)",
            "",
            "at most 2 MB more",
            late_kb <= early_kb + 2048 and count >= 1_000_000,
        )
    ]


PARTS: dict[str, Callable[[Path], list[Row]]] = {  # beside "setpoints"
    "flood": flood,
    "wildcards": wildcards,
    "idle": idle,
    "memory": memory,
}


def machine() -> str:
    """The machine in words."""
    cpu = next(
        (line.partition(": ")[2] for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        platform.machine(),
    )
    return (
        f"{os.cpu_count()} × {cpu}, Linux {platform.release()}, Python {platform.python_version()},"
        f" load before the run {os.getloadavg()[0]:.1f}"
    )


def main() -> int:
    """Run all parts, or one; the exit status is 0 whatever the figures, for a benchmark is no test."""
    parser = argparse.ArgumentParser(description="Measure the gateway beside a naive script.")
    parser.add_argument("--only", choices=(SETPOINTS, *PARTS))
    parser.add_argument("--quick", action="store_true", help="what setpoints cost, in the two streams that matter most")
    parser.add_argument(
        "--release", type=Path, metavar="FOLDER", help="compare setpoints with this tree's gateway, too"
    )
    options = parser.parse_args()
    where, begun_s = machine(), time.monotonic()
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        if options.only in (None, SETPOINTS):
            rows += duel(Path(folder), short=options.quick, release=options.release)
    parts = {} if options.quick else PARTS
    if parts and (lack := missing_packages()):
        say(f"the emulated device cannot be had: {lack}")
        parts = {}
    for name, part in parts.items():
        if options.only in (None, name):
            with tempfile.TemporaryDirectory() as folder:
                rows += part(Path(folder))
    print(as_text(rows))
    print(
        f"\n{where}; the run took {time.monotonic() - begun_s:.0f} s;"
        " ratios are medians over the slices (least to most)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
