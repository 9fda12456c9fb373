"""Two gateways at once, one with something and one without: what it costs a message."""

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.benchmarks.processes import Figures, cpu_ns, now_ns
from tests.benchmarks.subjects import SETTLE_S, Publisher, Subject

ROUNDS = 15
ROUND_S = 2.0


@dataclass
class Side:
    """One of the two, and its figures of each round."""

    subject: Subject
    publisher: Publisher
    cpu_us: list[float] = field(default_factory=list)
    """CPU time of a message."""
    p50_us: list[float] = field(default_factory=list)
    """Published → transferred."""
    p99_us: list[float] = field(default_factory=list)


def started(folder: Path, stack: ExitStack, settings: Mapping[str, Mapping[str, Any]]) -> tuple[Side, Side]:
    """A gateway with these settings, and one without; publishers of six legs at 50 Hz are connected."""
    sides = []
    for name, more in (("with", settings), ("without", {})):
        (folder / name).mkdir()
        subject = Subject("gateway", folder / name, stack, {section: dict(values) for section, values in more.items()})
        sides.append(Side(subject, subject.publisher("--legs", *"123456", "--hz", "50", "--shape", "apart")))
    return sides[0], sides[1]


def measure(sides: tuple[Side, Side]) -> None:
    """Both at once: the machine's speed, which changes within a round, is then the same for both."""
    for side in sides:
        side.publisher.run(0.5)
    for number in range(ROUNDS):
        begun_ns, begun_cpu_ns = now_ns(), [cpu_ns(side.subject.pid) for side in sides]
        for side in sides if number % 2 else reversed(sides):
            side.publisher.start(ROUND_S)
        counts = [side.publisher.wait() for side in sides]
        time.sleep(SETTLE_S)
        for side, before_ns, count in zip(sides, begun_cpu_ns, counts, strict=True):
            side.cpu_us.append((cpu_ns(side.subject.pid) - before_ns) / count / 1000)
            figures = Figures.of(side.publisher.latencies_ns(side.subject.device.written(begun_ns)))
            side.p50_us.append(figures.p50_us)
            side.p99_us.append(figures.p99_us)
