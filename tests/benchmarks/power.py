"""The power board: how soon its mask is on the bus, how soon it confirms, and what [power] costs a Stop on SPI.

Two gateways of HexapodProtocol v1.0.0 take turns, one of them with the simulated board in a process of its own behind
slcan on a pseudo terminal. In the column of the naive script is the gateway without a board, or the first Stop on SPI.
"""

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from gateway.client import Client
from schemas.robot import LEGS
from tests.benchmarks.processes import Figures, now_ns, say
from tests.benchmarks.table import Row, microseconds, ratio_row
from tests.hil.bed import SpiTestbed
from tests.hil.wire import STOPS
from tests.support.gateway_process import Gateway
from tests.support.recorded_board import RecordedBoard

ROUNDS = 10
STOPS_OF_A_ROUND = 20
FAULTY_STOPS = 200
FAULTS = {"lose": 0.07, "delay": 0.07, "corrupt": 0.07, "seed": 1}
"""Of the board's answers a fifth does not come as it was sent: 1 - 0.93³."""
MOST_FAULTY_MS = 700.0
LATE_S = 10.0
_WATCHDOG = {"timeout_ms": 10_000, "repeats": 1}
_POSE = dict.fromkeys(LEGS, (90.0, 90.0, 90.0))
_STOPS = frozenset(STOPS)


@dataclass
class _Side:
    """A gateway with or without a board, and its figures in µs."""

    bed: SpiTestbed
    client: Client
    board: RecordedBoard | None
    first_us: list[float] = field(default_factory=list)
    sixth_us: list[float] = field(default_factory=list)
    handed_us: list[float] = field(default_factory=list)
    """By the gateway's own clock: heard, until the last Stop was handed to the kernel."""
    mask_us: list[float] = field(default_factory=list)
    added_us: list[float] = field(default_factory=list)
    """Request → answer in the client's hands, without the board's own time from the mask to its answer, if any."""
    decided_us: list[float] = field(default_factory=list)
    """By the gateway's own clock: heard, until it has the confirmation, without the board's own time."""

    def stop(self) -> float | None:
        """The emergency stop, while all legs run. Returns after how many ms it was confirmed."""
        self.client.start_legs(_POSE)
        if self.board is not None:
            self.board.skip()
        since = len(self.bed.transfers)
        begun_ns = now_ns()
        ack = self.client.estop()
        ended_ns = now_ns()
        written = self.bed.wait_for(lambda each: sum(t.data.hex() in _STOPS for t in each[since:]) >= len(LEGS), LATE_S)
        stops_ns = [each.monotonic_ns for each in written[since:] if each.data.hex() in _STOPS]
        self.first_us.append((stops_ns[0] - begun_ns) / 1000)
        self.sixth_us.append((stops_ns[len(LEGS) - 1] - begun_ns) / 1000)
        self.handed_us.append(ack.latency_us or 0.0)
        theirs_ns = 0
        if self.board is not None:
            mask_ns = self.board.next("mask", 0).at_ns
            theirs_ns = self.board.next("answer", 0).at_ns - mask_ns
            self.mask_us.append((mask_ns - begun_ns) / 1000)
            self.decided_us.append(1000 * (ack.confirmed_ms or 0.0) - theirs_ns / 1000)
        self.added_us.append((ended_ns - begun_ns - theirs_ns) / 1000)
        self.client.reset()
        return ack.confirmed_ms if ack.confirmed else None

    def ready(self) -> None:
        """Wait until starts are taken."""
        if self.board is not None:
            self.board.next("fed", (1 << 18) - 1)


def _side(folder: Path, stack: ExitStack, *, power: bool) -> _Side:
    bed = stack.enter_context(SpiTestbed())
    bed.prefer()
    folder.mkdir()
    board = stack.enter_context(RecordedBoard(folder)) if power else None
    sections: dict[str, dict[str, Any]] = {"watchdog": _WATCHDOG, "log": {"level": "error"}}
    if board is not None:
        sections["power"] = board.settings
    gateway = stack.enter_context(Gateway(folder, sections, bed=bed))
    side = _Side(bed, stack.enter_context(gateway.client()), board)
    side.ready()
    return side


def power(folder: Path) -> list[Row]:
    """All of it."""
    with ExitStack() as stack:
        with_board, without = (_side(folder / str(each), stack, power=each) for each in (True, False))
        for number in range(ROUNDS):
            say(f"power: round {number + 1} of {ROUNDS}")
            for _ in range(STOPS_OF_A_ROUND):
                for side in (with_board, without):
                    side.stop()
        rows = _rows(with_board, without)
        say(f"power: {FAULTY_STOPS} emergency stops, a fifth of the board's answers lost, late or altered")
        assert with_board.board is not None
        with_board.board.disturb(**FAULTS)
        confirmed = [with_board.stop() for _ in range(FAULTY_STOPS)]
    in_time = [ms for ms in confirmed if ms is not None and ms <= MOST_FAULTY_MS]
    worst = f"worst {max(in_time, default=0):.0f} ms, p50 {median(in_time or [0]):.0f} ms"
    return [
        *rows,
        Row(
            f"power: emergency stops confirmed within {MOST_FAULTY_MS:g} ms, a fifth of the board's answers spoiled",
            f"{len(in_time)} of {FAULTY_STOPS}; {worst}",
            "",
            "all",
            len(in_time) == FAULTY_STOPS,
        ),
    ]


def _rows(ours: _Side, without: _Side) -> list[Row]:
    mask, first, added, decided, plain = (
        Figures.of([round(us * 1000) for us in each])
        for each in (ours.mask_us, ours.first_us, ours.added_us, ours.decided_us, without.added_us)
    )
    return [
        Row(
            f"power: emergency stop, asked → mask on the bus, p50 of {mask.count} (beside: the first Stop on SPI)",
            microseconds(mask.p50_us),
            microseconds(first.p50_us),
            "at most 1 ms, and the first Stop's",
            mask.p50_us <= min(1000, first.p50_us),
        ),
        Row(
            "power: the same, p99",
            microseconds(mask.p99_us),
            microseconds(first.p99_us),
            "at most 3 ms",
            mask.p99_us <= 3000,
        ),
        Row(
            "power: emergency stop, asked → confirmed, beyond the board's time, p50 (beside: without a board)",
            f"{microseconds(added.p50_us)} (p99 {microseconds(added.p99_us)})",
            f"{microseconds(plain.p50_us)} (p99 {microseconds(plain.p99_us)})",
            "at most 5 ms",
            added.p50_us <= 5000,
        ),
        Row(
            "power: the gateway's own part of it, p50",
            f"{microseconds(decided.p50_us)} (p99 {microseconds(decided.p99_us)})",
            "",
        ),
        *(
            ratio_row(
                f"power: emergency stop, {what} (beside: without a board)", _medians(with_), _medians(plain), "µs", None
            )
            for what, with_, plain in (
                ("asked → first Stop on SPI", ours.first_us, without.first_us),
                ("asked → sixth Stop on SPI", ours.sixth_us, without.sixth_us),
                ("heard → handed to the kernel", ours.handed_us, without.handed_us),
            )
        ),
    ]


def _medians(all_us: list[float]) -> list[float]:
    """Of each round."""
    return [median(all_us[place : place + STOPS_OF_A_ROUND]) for place in range(0, len(all_us), STOPS_OF_A_ROUND)]
