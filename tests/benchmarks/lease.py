"""What the lease costs: its token on each command, and ten clients that want it beside its holder's stream.

The gateway is compared with itself: rounds with and without, in turn, since a machine changes its speed within seconds.
"""

from contextlib import ExitStack, closing
from pathlib import Path

from tests.benchmarks.processes import Figures, cpu_ns, now_ns, say
from tests.benchmarks.subjects import SETTLE_S, Publisher, Subject, program
from tests.benchmarks.table import Row, ratio_row

ROUNDS = 9
ROUND_S = 2.0
FLOOD_HZ = 1000
SETTINGS = {"lease": {"ttl_ms": 10_000}, "watchdog": {"timeout_ms": 1000}, "limits": {"leg_rate_hz": 100}}
"""A limit above the stream's rate, so that no command that comes late is replaced by the next one."""
STREAM = ("--legs", "1", "2", "3", "4", "5", "6", "--hz", "50")


def lease(folder: Path) -> list[Row]:
    """Both."""
    with ExitStack() as stack:
        token = _token(folder, stack)
    with ExitStack() as stack:
        return [token, *_flood(folder, stack)]


def _round(subject: Subject, publisher: Publisher) -> tuple[Figures, float, int]:
    """Latencies, CPU time a message, and how many messages it were."""
    begun_ns, begun_cpu_ns = now_ns(), cpu_ns(subject.pid)
    count = publisher.run(ROUND_S)
    cpu_us = (cpu_ns(subject.pid) - begun_cpu_ns) / count / 1000
    return Figures.of(publisher.latencies_ns(subject.device.written(begun_ns))), cpu_us, count


def _token(folder: Path, stack: ExitStack) -> Row:
    """A stream whose commands carry the token, beside one of a gateway whose lease is free."""
    folders = [folder / name for name in ("with", "without")]
    for each in folders:
        each.mkdir()
    subjects = [Subject("gateway", each, stack, SETTINGS) for each in folders]
    options = [(*STREAM, "--lease"), STREAM]
    publishers = [subject.publisher(*extra) for subject, extra in zip(subjects, options, strict=True)]
    for publisher in publishers:
        publisher.run(0.5)  # whatever is slow only once
    found: tuple[list[float], list[float]] = ([], [])
    for number in range(ROUNDS):
        say(f"lease: a token on each command: round {number + 1} of {ROUNDS}")
        for index in (0, 1) if number % 2 else (1, 0):
            found[index].append(_round(subjects[index], publishers[index])[1])
    return ratio_row("lease: its token on each command, CPU time a message (beside: without)", *found, "µs", 1.03)


def _flood(folder: Path, stack: ExitStack) -> list[Row]:
    """The holder's stream, with and without ten others that ask."""
    subject = Subject("gateway", folder, stack, SETTINGS)
    publisher = subject.publisher(*STREAM, "--lease")
    askers = stack.enter_context(closing(program("lease_flood", subject.endpoint, "--hz", str(FLOOD_HZ))))
    askers.wait_for_output("ready", timeout_s=30)
    publisher.run(0.5)
    p99_us: tuple[list[float], list[float]] = ([], [])
    asked = answered = sent = arrived = floods = 0
    for number in range(2 * ROUNDS):
        say(f"lease: ten clients that want it: round {number + 1} of {2 * ROUNDS}")
        flooded = number % 2 == 0
        if flooded:
            floods += 1
            askers.tell(str(ROUND_S + SETTLE_S))
        figures, _, count = _round(subject, publisher)
        p99_us[0 if flooded else 1].append(figures.p99_us)
        if flooded:
            done = askers.wait_for_line(floods, 30).split()
            asked, answered = asked + int(done[1]), answered + int(done[2])
            sent, arrived = sent + count, arrived + figures.count
    rate_hz = asked / (floods * (ROUND_S + SETTLE_S))
    name = f"lease: its holder's stream at 50 Hz, p99, beside {rate_hz:,.0f} requests a second (beside: without)"
    return [
        ratio_row(name, *p99_us, "µs", 1.5),
        Row(
            "lease: commands of that stream that were written; requests that were answered",
            f"{arrived:,} of {sent:,}; {answered:,} of {asked:,}",
            "",
            "all; all",
            (arrived, answered) == (sent, asked),
        ),
    ]
