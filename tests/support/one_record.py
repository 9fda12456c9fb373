"""One record of each common kind, written into a black box."""

import time
from collections.abc import Callable
from pathlib import Path

from gateway.robot.blackbox.recorder import RingRecorder, Written
from gateway.robot.core.targets import Intent
from gateway.robot.protocol.frames import Op, ServoOp
from gateway.robot.settings import Settings
from schemas.keys import leg_command
from schemas.telemetry import Cause


def writers(folder: Path) -> dict[str, Callable[[], None]]:
    """What writes a record each time that it is called, by the record's name."""
    recorder = RingRecorder(
        Settings.model_validate({"recorder": {"path": str(folder)}}), {}, time.monotonic_ns, time.time_ns
    )
    recorder.open()
    intent = Intent(tuple((31 + joint, ServoOp(Op.SET, 90_00)) for joint in range(3)), "anna", 12.0)

    key = leg_command(3)

    def frame() -> None:
        recorder.step, recorder.told = [Written(b"\x0e" * 14, Cause.COMMAND, 5, 45_000)], 0
        recorder.frames()

    def setpoint() -> None:
        recorder.command(1, "put", key, "anna", intent, 5_000_000)
        recorder.step, recorder.told = [Written(b"\x0e" * 14, Cause.COMMAND, 5_100_000, 45_000)], 0
        recorder.decided(1, "accepted", key, "anna")

    return {
        "setpoint with its frame": setpoint,
        "command": lambda: recorder.command(0, "put", key, "anna", intent, 5_000_000),
        "decision": lambda: recorder.decided(1, "estopped", key, "anna"),
        "frame": frame,
    }
