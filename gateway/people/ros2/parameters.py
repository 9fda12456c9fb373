"""Settings of the bridge's reports: options of the command, and ROS parameters of the node."""

import math
import re
from dataclasses import dataclass
from typing import Final

from gateway.errors import ConfigError
from gateway.geometry.kinematics import BASE
from schemas.robot import MAX_DEG

RANGES: Final = {"joint_states_hz": (1.0, 50.0), "diagnostics_hz": (0.1, 10.0), "uncommanded_deg": (0.0, MAX_DEG)}
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

    joint_states_hz: float = 50.0
    diagnostics_hz: float = 1.0
    base_frame: str = BASE
    imu_frame: str = ""
    uncommanded_deg: float = math.nan

    def __post_init__(self) -> None:
        for name, (least, most) in RANGES.items():
            value = getattr(self, name)
            if not (least <= value <= most or (name == "uncommanded_deg" and math.isnan(value))):
                raise ConfigError(f"{name}: {value:g} is not between {least:g} and {most:g}")
        for name, frame in (("base_frame", self.base_frame), ("imu_frame", self.imu_frame or BASE)):
            if not _FRAME.fullmatch(frame):
                raise ConfigError(f"{name}: {frame[:80]!r} is no name of a frame, such as base_link")
