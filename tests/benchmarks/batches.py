"""What one call for all saves: request → sixth Stop, and `legs/cmd` → sixth frame, beside one call each and beside the
naive script, in one run. Times are the emulated device's, which makes each call last as long as the wire needs."""

import math
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from gateway.robot.protocol.framing import Framing
from schemas.keys import ESTOP, LEGS_COMMAND, leg_command
from schemas.robot import LEGS
from tests.benchmarks.processes import Figures, Written, now_ns, say
from tests.benchmarks.subjects import Subject
from tests.benchmarks.table import Row

COUNT = int(os.environ.get("COUNT", "200"))
AIM = 0.5
STOP_OP = 2
START = {"servos": [{"op": "start", "angle_deg": 90}] * 3}
ALL_START = {"legs": {str(leg): START for leg in LEGS}}
SETTLE_S = 0.12
"""Until the repeats are written."""
TIMEOUT_MS = 60
SILENCE_S = 0.25


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
        time.sleep(SETTLE_S / 4)
        return at_ns

    def silence() -> int:
        robot.publish(LEGS_COMMAND, ALL_START)
        at_ns = now_ns()
        time.sleep(SILENCE_S)
        return at_ns + TIMEOUT_MS * 1_000_000

    found = {"request → sixth emergency Stop": _measured(subject, STOP_OP, estop)}
    found["legs/cmd → sixth frame"] = _measured(subject, None, legs)
    if gateway:
        found["six legs silent → sixth Stop"] = _measured(subject, STOP_OP, silence)
    return found


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
        for what, figures in ours.items():
            ratio = figures.p50_us / single[what].p50_us
            beside = f"{naive[what].p50_us:.0f} µs" if what in naive else ""
            aim = AIM if "emergency" in what else math.inf
            rows.append(
                Row(
                    f"{framing}: {what}, p50 (p99)",
                    f"{figures.p50_us:.0f} µs ({figures.p99_us:.0f}); without batches {single[what].p50_us:.0f}"
                    f" ({single[what].p99_us:.0f}): {ratio:.2f}×",
                    beside,
                    f"at most {aim}×" if aim < math.inf else "",
                    ratio <= aim if aim < math.inf else None,
                )
            )
    return rows
