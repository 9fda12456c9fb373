"""What one call for all saves: request → sixth Stop, and `legs/cmd` → sixth frame, beside one call each and beside the
naive script, in one run. Times are the emulated device's, which makes each call last as long as the wire needs."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gateway.model.framing import Framing
from schemas.keys import ESTOP, LEGS_COMMAND, leg_command
from schemas.robot import LEGS
from tests.benchmarks.processes import Figures, Written, now_ns, say
from tests.benchmarks.subjects import Subject
from tests.benchmarks.table import Row

COUNT = int(os.environ.get("COUNT", "200"))
STOP_OP = 2
START = {"servos": [{"op": "start", "angle_deg": 90}] * 3}
ALL_START = {"legs": {str(leg): START for leg in LEGS}}
SETTLE_S = 0.1
"""Until the repeats are written."""
SLOT_S = 0.03
"""Until each leg has a rate slot again."""
TIMEOUT_MS = 60
REQUEST, LEGS_CMD, SILENCE = (
    "request → sixth emergency Stop",
    "legs/cmd → sixth frame",
    "six legs silent → sixth Stop",
)


def sixth_ns(written: list[Written], since_ns: int, op: int | None) -> int | None:
    """When the sixth leg's frame with this operation (None: any) began."""
    legs: set[int] = set()
    for each in written:
        if each.monotonic_ns >= since_ns and len(each.data) == 14 and op in (None, each.data[3]):
            legs.add(each.data[2] // 10)
            if len(legs) == len(LEGS):
                return each.monotonic_ns
    return None


def _measured(subject: Subject, op: int | None, begin: Callable[[], int]) -> Figures:
    begun = [begin() for _ in range(COUNT)]
    written = subject.device.written()
    sixth = [(sixth_ns(written, at_ns, op), at_ns) for at_ns in begun]
    return Figures.of([end_ns - at_ns for end_ns, at_ns in sixth if end_ns is not None])


def _figures(subject: Subject) -> dict[str, Figures]:
    """Of one subject, by what was measured."""
    robot = subject.client()
    gateway = subject.name == "gateway"

    def estop() -> int:
        at_ns = now_ns()
        if gateway:
            robot.publish(ESTOP, {})
        else:  # it knows no emergency stop
            for leg in LEGS:
                robot.publish(leg_command(leg), {"servos": [{"op": "stop"}] * 3})
        time.sleep(SETTLE_S)
        if gateway:
            robot.reset()
        return at_ns

    def legs() -> int:
        at_ns = now_ns()
        robot.publish(LEGS_COMMAND, ALL_START)
        time.sleep(SLOT_S)
        return at_ns

    def silence() -> int:
        robot.publish(LEGS_COMMAND, ALL_START)
        at_ns = now_ns()
        time.sleep(TIMEOUT_MS / 1000 + SETTLE_S)
        return at_ns + TIMEOUT_MS * 1_000_000

    found = {REQUEST: _measured(subject, STOP_OP, estop), LEGS_CMD: _measured(subject, None, legs)}
    if gateway:
        found[SILENCE] = _measured(subject, STOP_OP, silence)
    return found


def _row(framing: Framing, what: str, ours: Figures, single: Figures, naive: Figures | None) -> Row:
    ratio = ours.p50_us / single.p50_us
    aim, met = {
        REQUEST: ("at most 0.5× without batches", ratio <= 0.5),
        LEGS_CMD: ("at most 1.0× the naive script's", naive is not None and ours.p50_us <= naive.p50_us),
    }.get(what, ("", None))
    return Row(
        f"{framing}: {what}, p50 (p99) of {COUNT}",
        f"{ours.p50_us:.0f} µs ({ours.p99_us:.0f}); without batches {single.p50_us:.0f} ({single.p99_us:.0f}):"
        f" {ratio:.2f}×",
        "" if naive is None else f"{naive.p50_us:.0f} µs ({naive.p99_us:.0f}): {ours.p50_us / naive.p50_us:.2f}×",
        aim,
        met,
    )


def batches(folder: Path) -> list[Row]:
    """Both framings, with batches, without, and the naive script."""
    rows: list[Row] = []
    for framing in Framing:
        found: list[dict[str, Figures]] = []
        for name, batch in (("gateway", True), ("gateway", False), ("naive", True)):
            say(f"batches: {framing}, {name}{'' if batch else ' without batches'}")
            own = folder / f"{framing}-{name}-{batch}"
            own.mkdir()
            settings: dict[str, dict[str, Any]] = {
                "spi": {"framing": framing, "batch": batch, "resync_ms": 0},
                "watchdog": {"timeout_ms": TIMEOUT_MS},
            }
            with ExitStack() as stack:
                found.append(_figures(Subject(name, own, stack, settings)))
        ours, single, naive = found
        rows += [_row(framing, what, ours[what], single[what], naive.get(what)) for what in ours]
    return rows
