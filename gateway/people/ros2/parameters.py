"""Settings of the bridge's reports: options of the command, and ROS parameters of the node."""

import math
import re
from dataclasses import dataclass
from typing import Final

from gateway.errors import ConfigError
from gateway.geometry.kinematics import BASE
from schemas.robot import MAX_DEG

JOINT_STATES_HZ: Final = (1.0, 50.0)
DIAGNOSTICS_HZ: Final = (0.1, 10.0)
_FRAME: Final = re.compile(r"[A-Za-z_][\w./-]{0,63}", re.ASCII)
DESCRIPTIONS: Final = {
    "joint_states_hz": "most joint states a second, 1 to 50",
    "diagnostics_hz": "fewest diagnostics a second, 0.1 to 10",
    "base_frame": "the body's frame in the URDF, /tf and measurements",
    "imu_frame": "the frame of imu/data; empty: that of the body",
    "uncommanded_deg": "where joint_states has servos that were never commanded, 0 to 180; NaN: they are left out",
}


@dataclass(frozen=True)
class Parameters:
    """See DESCRIPTIONS. Raises ConfigError for a value out of its range."""

    joint_states_hz: float = JOINT_STATES_HZ[1]
    diagnostics_hz: float = 1.0
    base_frame: str = BASE
    imu_frame: str = ""
    uncommanded_deg: float = math.nan

    def __post_init__(self) -> None:
        _check("joint_states_hz", self.joint_states_hz, *JOINT_STATES_HZ)
        _check("diagnostics_hz", self.diagnostics_hz, *DIAGNOSTICS_HZ)
        if not math.isnan(self.uncommanded_deg):
            _check("uncommanded_deg", self.uncommanded_deg, 0.0, MAX_DEG)
        for name, frame in (("base_frame", self.base_frame), ("imu_frame", self.imu_frame or BASE)):
            if not _FRAME.fullmatch(frame):
                raise ConfigError(f"{name}: {frame[:80]!r} is no name of a frame, such as base_link")


def _check(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise ConfigError(f"{name}: {value:g} is not between {least:g} and {most:g}")
