"""Fifteen servo keys, each sent far more than its leg has rate slots for, and another leg beside."""

from contextlib import ExitStack
from pathlib import Path
from statistics import median

from tests.benchmarks.processes import Figures, now_ns, say
from tests.benchmarks.subjects import SETTLE_S, Subject
from tests.benchmarks.table import Row, microseconds

ROUNDS = 7
ROUND_S = 2.0
STREAM_HZ = 250
"""Five times `limits.leg_rate_hz` on each of the fifteen keys: 3 750 a second."""
AIM_MS = 10


def dense(folder: Path) -> list[Row]:
    """The other leg's frames: their ages, in rounds, since one stall of the machine would be the p99 of them all."""
    with ExitStack() as stack:
        subject = Subject("gateway", folder, stack)
        servos = subject.publisher("--legs", "1", "3", "4", "5", "6", "--hz", str(STREAM_HZ), "--shape", "servos")
        other = subject.publisher("--legs", "2", "--hz", "50")
        robot = subject.client()
        other.run(0.5)  # whatever is slow only once
        rounds: list[Figures] = []
        offered = 0
        before = robot.state().commands
        for number in range(ROUNDS):
            say(f"fifteen servo keys: round {number + 1} of {ROUNDS}")
            begun_ns = now_ns()
            servos.start(ROUND_S + SETTLE_S)  # until the other leg's last frame is written
            offered += other.run(ROUND_S) + servos.wait()
            rounds.append(Figures.of(other.latencies_ns(subject.device.written(begun_ns))))
        after = robot.state().commands
    p99_us = [figures.p99_us for figures in rounds]
    accepted = after.accepted - before.accepted
    return [
        Row(
            f"fifteen servo keys at {STREAM_HZ} Hz each: another leg at 50 Hz, p99",
            f"{microseconds(median(p99_us))} ({microseconds(min(p99_us))} to {microseconds(max(p99_us))};"
            f" p50 {microseconds(median(figures.p50_us for figures in rounds))};"
            f" {accepted:,} of {offered:,} commands accepted)",
            "",
            f"at most {AIM_MS} ms",
            median(p99_us) <= AIM_MS * 1000,
        )
    ]
