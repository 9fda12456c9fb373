"""One record of each common kind, written into a black box."""

import time
from collections.abc import Callable
from pathlib import Path

from gateway.robot.blackbox.recorder import ACCEPTED, Heard, Recorder
from gateway.robot.core.events import Transmit
from gateway.robot.protocol.frames import OneLeg, Op, ServoOp
from gateway.robot.settings import Settings
from gateway.robot.spi.bus import Sent
from schemas.keys import leg_command
from schemas.telemetry import Cause


def writers(folder: Path) -> dict[str, Callable[[], None]]:
    """What writes a record each time that it is called, by the record's name."""
    settings = Settings.model_validate({"recorder": {"path": str(folder)}})
    recorder = Recorder(settings, {}, time.monotonic_ns, time.time_ns)
    recorder.open()
    key, target = leg_command(3), ServoOp(Op.SET, 90_00)
    heard = Heard(5_000_000, 1, "put", key, "anna", 12.0, tuple((31 + joint, target) for joint in range(3)))
    sent = Sent(0, b"\x0e" * 14, 5_100_000, 45_000, heard=True)
    transmit = Transmit(OneLeg(3, (target, target, target)), Cause.COMMAND, None, (1,))

    return {
        "setpoint with its frame": lambda: recorder.step(heard, [(transmit, sent)], [(1, ACCEPTED, key, "anna")]),
        "command": lambda: recorder.step(heard, (), ()),
        "decision": lambda: recorder.step(None, (), [(1, "estopped", key, "anna")]),
        "frame": lambda: recorder.step(None, [(transmit, sent)], ()),
    }
