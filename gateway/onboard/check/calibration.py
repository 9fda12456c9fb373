"""The calibration that the service would start with."""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from gateway.durable import staged_for
from gateway.model.angle_limits import AngleLimits
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import centidegrees
from gateway.onboard.check.result import Result, failure, ok, warning
from gateway.own_command import command
from gateway.robot.core.calibrating import ACCEPT_DEFAULT
from gateway.robot.host.calibration_file import SLOW_S, load, path_to_read
from gateway.robot.settings import Settings

_NAME: Final = "calibration"


def kept(settings: Settings) -> Result:
    """Whether it can be used; without one that can, the service starts, and moves nothing."""
    path = path_to_read(settings)
    if path is None:
        return ok(_NAME, "is kept in memory only, until the gateway ends (state.path)")
    if path.parent.exists() and not os.access(path.parent, os.X_OK):
        return warning(_NAME, f"{path} is not for you to read", "sudo hexapod-gateway check")
    found, fault = load(path)
    if fault is not None:
        fix = f"put a good one in its place and restart, or, if the robot is as drawn: {command(ACCEPT_DEFAULT)}"
        return failure(_NAME, f"{fault}; nothing can be started", fix)
    begun_s = _begun_s(path)
    if begun_s is not None and time.time() - begun_s > SLOW_S:
        at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(begun_s))
        fix = "if the gateway runs, its disk hangs (dmesg): restart it once that is fixed; else nothing is wrong"
        return warning(_NAME, f"a change of {at} was not kept, and revision {found.revision} is ({path})", fix)
    if not (found.servos or found.landing_cdeg):
        return ok(_NAME, f"none: every servo is as drawn ({path})")
    count = len(found.servos)
    return ok(_NAME, f"revision {found.revision}, {count} servo{'' if count == 1 else 's'} ({path})")


def landing_pose(settings: Settings) -> Iterator[Result]:
    """Whether each angle of the landing pose may be sent, where there is one and the calibration can be used."""
    path = path_to_read(settings)
    found, fault = (RobotCalibration(), None) if path is None else load(path)
    if fault is not None or not settings.watchdog.landing_ms:
        return
    pose = {int(servo): centidegrees(angle) for servo, angle in settings.watchdog.landing.items()}
    reach = AngleLimits(avoid_cdeg=settings.spi.avoid_cdeg)
    for servo_id, angle_cdeg in sorted({**pose, **found.landing_cdeg}.items()):
        why_not = reach.why_avoided(found, servo_id, angle_cdeg)
        if why_not is not None:
            fix = f"choose another angle: watchdog.landing in the configuration, or {command('calibrate landing')}"
            yield warning("landing pose", f"{why_not}; in a landing it holds its angle", fix)


def _begun_s(path: Path) -> float | None:
    """When a change was begun to be written that was not ended, in seconds of the clock that people read."""
    try:
        return staged_for(path).lstat().st_mtime
    except OSError:
        return None
