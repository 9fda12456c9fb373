"""What a landing costs a Stop: a gateway that lands beside one that stops at once, in turn, on a busy machine.

Both stop all six legs when one falls silent (`watchdog.scope`), so that the sixth Stop is the same thing for both. All
the while another leg is flooded with starts, and a program spins on every core. Times are the emulated device's.

A landing rejects what it is flooded with, and to reject a command takes longer than to replace it by the next one. What
of the difference is that, `rejected` shows: there the flood's leg may not go where it is sent, with either gateway.
"""

import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

from gateway.client import Client
from gateway.model.frames import Frame, FrameError, Op, decode
from tests.benchmarks.processes import Written, now_ns, say
from tests.benchmarks.subjects import Subject
from tests.benchmarks.table import Row, microseconds, ratio_row
from tests.support.child import Child

TIMEOUT_MS, LANDING_MS = 60.0, 160.0
LEG, FLOODED_LEG = 3, 6
START = (90, 45, 120)
POSE = {"31": 30.0, "32": 60.0, "33": 150.0}
SLACK_S = 0.025
"""After each round: the Stops are written."""
LONGER = 1.2
"""The flood goes on for so much longer than a block's pauses, since its commands take their time, too."""
NICE = -10
"""A laptop has processors of its own; this process is the one that presses the emergency stop."""
ABOVE_THE_FLOOD = 170.0
"""Degrees: no flood numbers its messages up to there."""
EARLY_MS = 5.0
"""Stops that are earlier than that are another leg's silence: the flood itself had no processor for so long."""
MOST = 1.25


@dataclass(frozen=True)
class _Flood:
    """What a run has beside its silences and emergency stops."""

    rejected: bool
    """By both gateways; else only while the robot lands."""
    blocks: int
    rounds: int
    """In each block."""


ACCEPTED = _Flood(rejected=False, blocks=5, rounds=40)
REJECTED = _Flood(rejected=True, blocks=5, rounds=12)


@dataclass
class _Found:
    """Of one gateway: by block, in µs."""

    late_us: list[list[float]] = field(default_factory=list)
    """A silent leg's sixth Stop, later than it was due."""
    landed_us: list[float] = field(default_factory=list)
    """The last frame of a landing, after the silent leg's last command."""
    estop_us: list[list[float]] = field(default_factory=list)
    """Emergency stop requested → sixth Stop."""
    left_out: int = 0


class _Side:
    """One of the two gateways."""

    def __init__(self, name: str, folder: Path, stack: ExitStack, landing_ms: float, flood: _Flood) -> None:
        (folder / name).mkdir()
        settings: dict[str, dict[str, Any]] = {
            "watchdog": {"timeout_ms": TIMEOUT_MS, "scope": "robot", "repeats": 0, "landing_ms": landing_ms},
            "watchdog.landing": POSE if landing_ms else {},
            "limits.servos.61": {"min_deg": ABOVE_THE_FLOOD if flood.rejected else 0.0},
        }
        self._rounds = flood.rounds
        self.name = name
        self.due_ms = TIMEOUT_MS + landing_ms
        self.subject = Subject("gateway", folder / name, stack, settings)
        self.flood = self.subject.publisher("--legs", str(FLOODED_LEG), "--hz", "0")
        self.found = _Found()
        self.robot: Client

    def block(self) -> None:
        """Silences, then emergency stops."""
        with self._flooded(self._rounds * (self.due_ms / 1000 + SLACK_S)):
            begun_ns = now_ns()
            for _ in range(self._rounds):
                self._start()
                time.sleep(self.due_ms / 1000 + SLACK_S)
            self._silences(self.subject.device.written(begun_ns))
        in_the_middle_s = (TIMEOUT_MS + self.due_ms) / 2000 if self.due_ms > TIMEOUT_MS else TIMEOUT_MS / 2000
        with self._flooded(self._rounds * (in_the_middle_s + SLACK_S)):
            begun_ns = now_ns()
            requests: list[int] = []
            for _ in range(self._rounds):
                self._start()
                time.sleep(in_the_middle_s)
                requests.append(now_ns())
                self.robot.estop()
                self.robot.reset()
                time.sleep(SLACK_S)
            self._estops(self.subject.device.written(begun_ns), requests)

    def _start(self) -> None:
        deadline_s = time.monotonic() + 5
        while not self.robot.start_leg(LEG, *START).accepted:  # a silence of the flood's leg may have begun a landing
            if time.monotonic() > deadline_s:
                raise RuntimeError(f"{self.name}: leg {LEG} cannot be started")

    @contextmanager
    def _flooded(self, least_s: float) -> Iterator[None]:
        self.flood.start(LONGER * least_s)
        yield
        self.flood.wait()

    def _silences(self, written: list[Written]) -> None:
        frames = list(_frames(written))
        starts = [place for place, (_, frame) in enumerate(frames) if _is(frame, LEG, Op.START)]
        late_us: list[float] = []
        for begin, end in pairwise([*starts, len(frames)]):
            began_ns = frames[begin][0]
            stop = next((n for n in range(begin, end) if _is(frames[n][1], LEG, Op.STOP)), None)
            sixth_ns = None if stop is None else _first(frames[stop:end], 6, Op.STOP)
            if sixth_ns is None:
                raise RuntimeError(f"{self.name}: a silent leg was not stopped")
            late_ms = (sixth_ns - began_ns) / 1e6 - self.due_ms
            if late_ms < -EARLY_MS:
                self.found.left_out += 1
                continue
            late_us.append(1000 * late_ms)
            way = [at_ns for at_ns, frame in frames[begin:stop] if _is(frame, LEG, Op.SET)]
            self.found.landed_us += [(way[-1] - began_ns) / 1000] if way else []
        self.found.late_us.append(late_us)

    def _estops(self, written: list[Written], requests: list[int]) -> None:
        frames = list(_frames(written))
        found_us: list[float] = []
        for requested_ns in requests:
            before = [frame for at_ns, frame in frames if at_ns < requested_ns and frame.servos[0][0] // 10 == LEG]
            if not before or not _is(before[-1], LEG, Op.SET if self.due_ms > TIMEOUT_MS else Op.START):
                self.found.left_out += 1  # it had not begun, or was over
                continue
            first_ns = _first([each for each in frames if each[0] >= requested_ns], 1, Op.STOP)
            sixth_ns = _first([each for each in frames if first_ns is not None and each[0] > first_ns], 6, Op.STOP)
            if sixth_ns is None:
                raise RuntimeError(f"{self.name}: an emergency stop did not stop all legs")
            found_us.append((sixth_ns - requested_ns) / 1000)
        self.found.estop_us.append(found_us)


def _frames(written: list[Written]) -> Iterator[tuple[int, Frame]]:
    for each in written:
        with suppress(FrameError):
            yield each.monotonic_ns, decode(each.data)


def _is(frame: Frame, leg: int, op: Op) -> bool:
    servo_id, command = frame.servos[0]
    return servo_id // 10 == leg and command.op is op


def _first(frames: list[tuple[int, Frame]], leg: int, op: Op) -> int | None:
    """All six Stops of a step come in the order of their legs."""
    return next((at_ns for at_ns, frame in frames if _is(frame, leg, op)), None)


def landing(folder: Path, flood: _Flood = ACCEPTED) -> list[Row]:
    """Both. In the column of the naive script: the gateway that stops at once."""
    with ExitStack() as stack:
        lands = _Side("lands", folder, stack, LANDING_MS, flood)
        stops = _Side("stops", folder, stack, 0, flood)
        for _ in range(os.cpu_count() or 1):
            stack.enter_context(closing(Child([sys.executable, "-c", "while True: pass"], os.environ)))
        with suppress(PermissionError):
            before = os.getpriority(os.PRIO_PROCESS, 0)
            stack.callback(os.setpriority, os.PRIO_PROCESS, 0, before)
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
        for side in (lands, stops):
            side.robot = side.subject.client()
        for number in range(flood.blocks):
            for side in (lands, stops) if number % 2 else (stops, lands):
                say(f"landing: block {number + 1} of {flood.blocks}, the gateway that {side.name}")
                side.block()
    return _rows("landing, flood rejected by both" if flood.rejected else "landing", lands.found, stops.found)


def landing_rejected(folder: Path) -> list[Row]:
    """The same with a flood that both reject: what is left of the difference is the landing's."""
    return landing(folder, REJECTED)


def _rows(part: str, lands: _Found, stops: _Found) -> list[Row]:
    late, plain, estops, plain_estops = (
        [each_us for block in blocks for each_us in block]
        for blocks in (lands.late_us, stops.late_us, lands.estop_us, stops.estop_us)
    )
    landed_ms = sorted(each / 1000 for each in lands.landed_us)
    beside = "(beside: stops at once)"
    return [
        Row(
            f"{part}: silence → its last frame, p50 and worst of {len(landed_ms)}",
            f"{median(landed_ms):.1f} and {landed_ms[-1]:.1f} ms",
            "",
            f"before {TIMEOUT_MS:g} + {LANDING_MS:g} ms",
            landed_ms[-1] < TIMEOUT_MS + LANDING_MS,
        ),
        ratio_row(f"{part}: sixth Stop later than due, p50 {beside}", *_p50(lands.late_us, stops.late_us), "µs", MOST),
        _worst(f"{part}: the same, worst of {len(late)} and {len(plain)}", late, plain),
        ratio_row(
            f"{part}: emergency stop in its middle → sixth Stop, p50 {beside}",
            *_p50(lands.estop_us, stops.estop_us),
            "µs",
            MOST,
        ),
        _worst(f"{part}: the same, worst of {len(estops)} and {len(plain_estops)}", estops, plain_estops),
        Row(
            f"{part}: rounds that another silence spoiled, left out",
            str(lands.left_out),
            str(stops.left_out),
        ),
    ]


def _p50(ours: list[list[float]], theirs: list[list[float]]) -> tuple[list[float], list[float]]:
    return [median(block) for block in ours], [median(block) for block in theirs]


def _worst(name: str, ours_us: list[float], theirs_us: list[float]) -> Row:
    return Row(name, microseconds(max(ours_us)), microseconds(max(theirs_us)))
