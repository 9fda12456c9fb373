"""Streams at a steady rate, gateway and naive script in turn: latency, and CPU time for a message."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

from gateway.model.framing import Framing
from tests.benchmarks.processes import Figures, cpu_ns, now_ns, say
from tests.benchmarks.subjects import Publisher, Subject
from tests.benchmarks.table import Row, ratio_row

LAST_LEG = 6


@dataclass(frozen=True, slots=True)
class Aims:
    """The most that the median of the ratios may be; None: nothing is aimed at."""

    p50: float | None = None
    p99: float | None = None
    cpu: float | None = None


@dataclass(frozen=True, slots=True)
class Scenario:
    """One kind of stream."""

    name: str
    shape: str
    legs: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    hz: int = 50
    framing: Framing = Framing.PLAIN
    lease: bool = False
    """Whether each message to the gateway has the lease's token, as a walk's have; the naive script knows none."""
    aims: Aims = Aims()
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    short: bool = True
    """Whether it is part of a quick run."""

    @property
    def title(self) -> str:
        return f"{self.name}, {self.hz} Hz" + ("" if self.framing is Framing.PLAIN else f", {self.framing}")

    @property
    def measured(self) -> str:
        """What its latency is."""
        return "publish → sixth frame" if self.shape in ("burst", "one-message") else "publish → transfer"


_LEG_BY_LEG = Aims(p50=1.2, p99=1.3, cpu=1.6)
_ONE_MESSAGE = Aims(p50=0.8, cpu=1.2)
SCENARIOS = (
    Scenario("six legs", "apart", aims=_LEG_BY_LEG),
    Scenario("a stream's legs/cmd", "one-message", aims=_ONE_MESSAGE),
    Scenario("six legs in one burst", "burst", aims=Aims(p50=1.15)),
    Scenario("six legs", "apart", framing=Framing.LENGTH_PREFIXED, aims=_LEG_BY_LEG, short=False),
    Scenario("a stream's legs/cmd", "one-message", framing=Framing.LENGTH_PREFIXED, aims=_ONE_MESSAGE, short=False),
    # The lease outlasts the other's rounds.
    Scenario(
        "a walk's legs/cmd",
        "one-message",
        lease=True,
        aims=_ONE_MESSAGE,
        settings={"lease": {"ttl_ms": 10_000}},
        short=False,
    ),
    Scenario("one leg", "apart", legs=(3,), short=False),
    Scenario("six legs", "apart", hz=200, settings={"limits": {"leg_rate_hz": 250}}, short=False),
)


@dataclass(frozen=True, slots=True)
class _Round:
    """What one round gave, in µs."""

    p50: float
    p99: float
    cpu: float


def _round(subject: Subject, publisher: Publisher, scenario: Scenario, duration_s: float) -> _Round:
    begun_ns, begun_cpu_ns = now_ns(), cpu_ns(subject.pid)
    count = publisher.run(duration_s)
    cpu_us = (cpu_ns(subject.pid) - begun_cpu_ns) / count / 1000
    leg = LAST_LEG if scenario.shape in ("burst", "one-message") else None
    figures = Figures.of(publisher.latencies_ns(subject.device.written(begun_ns), leg))
    return _Round(figures.p50_us, figures.p99_us, cpu_us)


def run(scenario: Scenario, folder: Path, stack: ExitStack, *, rounds: int, round_s: float) -> list[Row]:
    """Alternating rounds of both: the machine changes its pace within seconds, so the ratio within a round counts."""
    settings = {"spi": {"framing": scenario.framing}, **scenario.settings}
    subjects = [Subject(name, folder, stack, settings) for name in ("gateway", "naive")]
    options = ("--legs", *map(str, scenario.legs), "--hz", str(scenario.hz), "--shape", scenario.shape)
    ours, theirs = subjects
    publishers = [ours.publisher(*options, *(("--lease",) if scenario.lease else ())), theirs.publisher(*options)]
    for publisher in publishers:
        publisher.run(0.5)  # whatever is slow only once
    found: tuple[list[_Round], list[_Round]] = ([], [])
    title = scenario.title
    for number in range(rounds):
        say(f"{title}: round {number + 1} of {rounds}")
        for index in (0, 1) if number % 2 else (1, 0):
            found[index].append(_round(subjects[index], publishers[index], scenario, round_s))
    aims, what = scenario.aims, scenario.measured
    return [
        ratio_row(f"{title}: {figure}", [of(each) for each in found[0]], [of(each) for each in found[1]], "µs", aim)
        for figure, of, aim in (
            (f"{what}, p50", attrgetter("p50"), aims.p50),
            (f"{what}, p99", attrgetter("p99"), aims.p99),
            ("CPU time a message", attrgetter("cpu"), aims.cpu),
        )
    ]
