"""What floods on wildcards cost an emergency stop: request → sixth Stop, beside a quiet gateway's in the same round."""

import json
import os
import sys
import time
from contextlib import ExitStack, closing
from itertools import groupby
from pathlib import Path
from statistics import median

from gateway.client import leg_payload
from schemas.keys import leg_command
from tests.attack.flood import DELETE
from tests.benchmarks.processes import Written, never_delay, now_ns, say, sixth_stop_us
from tests.benchmarks.subjects import Subject
from tests.benchmarks.table import Row, microseconds
from tests.support.child import Child

ROUNDS = 3
STOPS = 10
"""In each round and flood."""
NICE = ("nice", "-n", "8")
"""Flooders are on other machines: what they compute takes no processor from the gateway."""
PAUSE_S = 0.12
"""After a request, and after its reset."""
TIMES_QUIET = 2.5
WORST_MS = 100
QUIET = "quiet"
SETS = json.dumps(leg_payload("set", (90, 90, 90)))
FLOODS: dict[str, tuple[int, str, str]] = {
    QUIET: (0, "", ""),
    "one key, 4 sessions": (4, leg_command(1), SETS),
    "leg/*/cmd, sets, 4 sessions": (4, "hexapod/leg/*/cmd", SETS),
    "*/*/cmd, deletes, 4 sessions": (4, "hexapod/*/*/cmd", DELETE),
    "*/*/cmd, deletes, 12 sessions": (12, "hexapod/*/*/cmd", DELETE),
}
"""How many sessions flood which key, with what. One alone did not delay it: 2.8 ms in place of 1.9."""


def wildcards(folder: Path) -> list[Row]:
    """Emergency stops without a flood and in each flood, in turns."""
    found: dict[str, list[float]] = {name: [] for name in FLOODS}
    with ExitStack() as stack:
        subject = Subject("gateway", folder, stack, prefix=("setsid",))  # as a service, it leads a session
        for number in range(ROUNDS):
            for name, flood in FLOODS.items():
                found[name] += _round(subject, *flood)
                say(f"round {number + 1}, {name}: p50 {microseconds(median(found[name][-STOPS:]))}")
    quiet_us = median(found[QUIET])
    return [_row(name, stops_us, quiet_us) for name, stops_us in found.items()]


def _row(name: str, stops_us: list[float], quiet_us: float) -> Row:
    times = median(stops_us) / quiet_us
    return Row(
        f"emergency stop → sixth Stop, {name}: p50 and worst of {len(stops_us)}",
        f"{microseconds(median(stops_us))} and {microseconds(max(stops_us))}, {times:.1f}×",
        "",
        "" if name == QUIET else f"at most {TIMES_QUIET}× and {WORST_MS} ms",
        None if name == QUIET else times <= TIMES_QUIET and max(stops_us) <= WORST_MS * 1000,
    )


def _round(subject: Subject, sessions: int, key: str, payload: str) -> list[float]:
    with ExitStack() as stack:
        robot = subject.client()
        command = [*NICE, sys.executable, "-m", "tests.attack.flood", subject.endpoint, key, payload]
        for _ in range(sessions):
            stack.enter_context(closing(Child(command, os.environ))).wait_for_output("flooding")
        # The requester is on another machine, too: else it waits for processors that the flood keeps busy here.
        never_delay(os.getpid())
        time.sleep(0.4)
        requests: list[int] = []
        begun_ns = now_ns()
        for _ in range(STOPS):
            requests.append(now_ns())
            robot.estop()
            time.sleep(PAUSE_S)
            robot.reset()
            time.sleep(PAUSE_S)
    time.sleep(0.3)  # what the flood has left in sockets
    written = subject.device.written(begun_ns)
    return [_own_stops_us(written, requested_ns) for requested_ns in requests]


def _own_stops_us(written: list[Written], requested_ns: int) -> float:
    """Until the last of an emergency stop's six Stops, which go in one call: a flood of deletes makes Stops, too."""
    later = [each for each in written if each.monotonic_ns >= requested_ns]
    for _, call in groupby(later, lambda each: each.call):
        transfers = list(call)
        if sixth_stop_us(transfers, requested_ns) is not None:
            return (transfers[-1].monotonic_ns - requested_ns) / 1000
    return float("inf")
