"""One record of each common kind, written into a black box."""

import time
from collections.abc import Callable
from pathlib import Path

from gateway.model.black_box.format import ACCEPTED
from gateway.model.frames import OneLeg, Op, ServoOp
from gateway.robot.blackbox.recorder import Recorder
from gateway.robot.core.events import Command, Transmit
from gateway.robot.protocol import Sent
from gateway.robot.settings import Settings
from schemas.keys import leg_command
from schemas.telemetry import Cause, Reason


def writers(folder: Path) -> dict[str, Callable[[], None]]:
    """What writes a record each time that it is called, by the record's name."""
    settings = Settings.model_validate({"state": {"path": str(folder)}})
    recorder = Recorder(settings, {}, time.monotonic_ns, time.time_ns)
    recorder.open()
    key, target = leg_command(3), ServoOp(Op.SET, 90_00)
    targets = tuple((31 + joint, target) for joint in range(3))
    heard = Command(targets, key=key, source="anna", sent_ms=12.0, received_ns=5_000_000, number=1)
    sent = Sent(0, b"\x0e" * 14, 5_100_000, 45_000, heard=True)
    transmit = Transmit(OneLeg(3, (target, target, target)), Cause.COMMAND, None, (heard,), (heard,))

    return {
        "setpoint with its frame": lambda: recorder.step(heard, [(transmit, sent)], [(heard, ACCEPTED, "")]),
        "command": lambda: recorder.step(heard, (), ()),
        "decision": lambda: recorder.step(None, (), [(heard, Reason.ESTOPPED, "")]),
        "frame": lambda: recorder.step(None, [(transmit, sent)], ()),
    }
