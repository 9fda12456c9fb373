"""A gateway of elkapod-2025 beside one of v1.0.0: how soon a Stop is said, and how even the cycle is."""

import itertools
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from gateway.client import Client
from gateway.model.elkapod import SHUTDOWN
from gateway.model.frames import stop_leg
from schemas.robot import LEGS
from tests.benchmarks.processes import Figures, now_ns, say
from tests.benchmarks.subjects import Publisher
from tests.benchmarks.table import Row, ratio_row
from tests.hil.bed import Event, Message, SpiTestbed, Transfer
from tests.hil.elkapod_bed import ElkapodBed
from tests.support.gateway_process import Gateway

ROUNDS = 5
STOPS = 12
"""Of a round, of each gateway."""
PERIOD_US = 20_000.0
LATE_S = 10.0
ROUND_S = 6.0
"""Of a flood, in which a round's Stops are asked for."""
POSE = dict.fromkeys(LEGS, (90.0, 90.0, 90.0))
_WATCHDOG = {"timeout_ms": 10_000, "repeats": 1}
_LAST = stop_leg(LEGS[-1]).to_bytes()


@dataclass
class _Side:
    """One of the two, and its figures by whether one leg was flooded."""

    gateway: Gateway
    bed: SpiTestbed
    is_stop: Callable[[Event], bool]
    client: Client
    flood: Publisher
    stop_us: dict[bool, list[float]] = field(default_factory=lambda: {False: [], True: []})
    """The median of each round."""
    uneven_us: dict[bool, list[float]] = field(default_factory=lambda: {False: [], True: []})
    """Of each two frames, how far the time between them is from the period."""

    def stop(self) -> float:
        """All legs run, and somebody presses the emergency stop: until the last of it is said, in µs."""
        self.client.start_legs(POSE)
        since = len(self.bed.events)
        begun_ns = now_ns()
        self.client.estop()
        self.bed.wait_for(lambda _: any(map(self.is_stop, self.bed.follow(since, 0) or [])), LATE_S)
        found = next(event for event in self.bed.events[since:] if self.is_stop(event))
        self.client.reset()
        return (found.monotonic_ns - begun_ns) / 1000

    def round(self, *, flooded: bool) -> None:
        """Some Stops, one after the other."""
        if flooded:
            self.flood.start(ROUND_S)
        since = len(self.bed.events)
        self.stop_us[flooded].append(median(self.stop() for _ in range(STOPS)))
        frames_ns = [event.monotonic_ns for event in self.bed.events[since:] if isinstance(event, Transfer)]
        self.uneven_us[flooded] += [abs((b - a) / 1000 - PERIOD_US) for a, b in itertools.pairwise(frames_ns)]
        if flooded:
            self.flood.wait()


def _side(folder: Path, stack: ExitStack, bed: SpiTestbed) -> _Side:
    stack.enter_context(bed)
    bed.prefer()
    elkapod = isinstance(bed, ElkapodBed)
    sections: dict[str, dict[str, Any]] = {"watchdog": _WATCHDOG, "log": {"level": "error"}}
    gateway = Gateway(folder, bed.settings_with(**sections) if isinstance(bed, ElkapodBed) else sections, bed=bed)
    stack.enter_context(gateway)
    flood = Publisher(gateway.endpoint, folder / f"{elkapod}.published", ("--legs", "1", "--hz", "0"))
    stack.callback(flood.child.close)

    def says_all(event: Event) -> bool:
        return isinstance(event, Message) and event.data == SHUTDOWN

    def stops_last(event: Event) -> bool:
        return isinstance(event, Transfer) and event.data == _LAST

    client = stack.enter_context(gateway.client())
    return _Side(gateway, bed, says_all if elkapod else stops_last, client, flood)


def cycle(folder: Path) -> list[Row]:
    """In the column of the naive script: the gateway of HexapodProtocol v1.0.0, up to the sixth Stop."""
    rows = []
    with ExitStack() as stack:
        ours, theirs = _side(folder, stack, ElkapodBed(folder)), _side(folder, stack, SpiTestbed())
        for number in range(ROUNDS):
            for flooded in (False, True):
                say(f"elkapod-2025 beside v1.0.0, round {number + 1}{', one leg flooded' if flooded else ''}")
                for side in (ours, theirs):
                    side.round(flooded=flooded)
    for flooded, when in ((False, ""), (True, ", one leg flooded")):
        name = "elkapod-2025 (beside: v1.0.0's sixth Stop): emergency stop → shutdown on the UART"
        rows.append(ratio_row(name + when, ours.stop_us[flooded], theirs.stop_us[flooded], "µs", None))
        uneven = Figures.of([round(each * 1000) for each in ours.uneven_us[flooded]])
        stop_us = median(theirs.stop_us[flooded])
        rows.append(
            Row(
                f"elkapod-2025: how far its cycle is from 20 ms, p99 of {uneven.count}{when}",
                f"{uneven.p99_us:.0f} µs ({uneven.p99_us / stop_us:.2f}× v1.0.0's emergency stop)",
                "",
            )
        )
    return rows
