"""What a setpoint costs: the bytecodes of a whole tick of a stream that is older than 0.8 s.

The distinct ones predict its time: between two setpoints other programs use the caches (a change with 9 % more distinct
ones took 10 % longer; one with 17 % fewer executed ones, 1 to 4 % less). `python -m tests.benchmarks` measures times.
"""

import asyncio
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

import gateway
from schemas import keys
from schemas.robot import LEGS
from tests.support.robot import leg, started, started_and_quiet

pytestmark = pytest.mark.virtual_time

OURS = (str(Path(gateway.__file__).parent), "<string>")
"""Where the gateway's own code stands; dataclasses write theirs as <string>."""


def bytecodes(call: Callable[[], None]) -> tuple[int, int]:
    """Return how many bytecodes of the gateway a call executes, and how many of them are distinct."""
    executed, distinct = 0, set[tuple[CodeType, int]]()

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal executed
        frame.f_trace = trace  # from Python 3.13 on the next line has an effect only on a frame that is traced already
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        if event == "opcode" and frame.f_code.co_filename.startswith(OURS):
            executed += 1
            distinct.add((frame.f_code, frame.f_lasti))
        return trace

    before = sys.gettrace()
    sys._getframe().f_trace_opcodes = True  # Python 3.12 traces opcodes only if a frame wanted them before settrace
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return executed, len(distinct)


@pytest.mark.parametrize(
    ("whole", "recorded", "executed", "distinct"),
    [(False, False, 1_100, 1_010), (False, True, 1_280, 1_190), (True, True, 2_930, 1_250)],
    ids=["a leg, no black box", "a leg", "all legs"],
)
async def test_a_setpoint_of_a_steady_stream_takes_few_bytecodes(
    whole: bool, recorded: bool, executed: int, distinct: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sections: dict[str, dict[str, Any]] = {"state": {"path": str(tmp_path)}} if recorded else {}
    robot = started(**sections, watchdog={"timeout_ms": 10_000})
    robot.conductor.recorder.open(nullcontext())
    monkeypatch.setattr(robot.controller, "transfer", lambda _: None)  # it answers at once

    def put_later(number: int, op: str, angle_deg: float) -> None:
        setpoint, source = leg(op, angle_deg, 45, 120), {"source": "anna"}
        robot._instants += 1
        if whole:
            robot.put_later(keys.LEGS_COMMAND, {"legs": {str(each): setpoint for each in LEGS}, **source})
        else:
            robot.put_later(keys.leg_command(1 + number % len(LEGS)), {**setpoint, **source})

    for number in range(400):
        put_later(number, "set" if number > len(LEGS) else "start", 90 + number / 100)
        robot.conductor.tick()
        await asyncio.sleep(0.02 if whole else 0.0034)
    put_later(400, "set", 93)  # an angle that has been sent before
    ran, different = bytecodes(robot.conductor.tick)
    more = 1 if sys.version_info < (3, 12) else 1.2  # the bounds are for Python 3.11
    assert executed / 2 < ran <= executed * more
    assert distinct / 2 < different <= distinct * more


async def test_an_emergency_stop_while_all_legs_run_takes_few_bytecodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stream is older than 0.8 s, when legs at rest would be due."""
    robot = await started_and_quiet()
    for _ in range(60):
        robot.put(keys.LEGS_COMMAND, {"legs": {str(each): leg("start", 90, 45, 120) for each in LEGS}})
        await asyncio.sleep(0.02)
    monkeypatch.setattr(robot.controller, "transfer", lambda _: None)  # without the simulated controller
    ran, different = bytecodes(lambda: robot.put(keys.ESTOP, {}))
    more = 1 if sys.version_info < (3, 12) else 1.3
    assert ran <= 11_400 * more
    assert different <= 3_800 * more
