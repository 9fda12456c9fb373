"""Joint names and radians, as controllers of ROS 2 send them, to the degrees of whole legs. Pure."""

import math
import re
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Final

from gateway.geometry import Geometry, joint_name
from gateway.people.walking.inverse import Angles
from schemas.robot import JOINTS, LEGS, MAX_DEG, SERVO_IDS

_PATTERN: Final = re.compile(r"(\{leg\}|\{joint\}|[\w./-]){1,64}", re.ASCII)


class JointsError(ValueError):
    """A controller requests something impossible; one sentence."""


class JointNames:
    """The joints' names in ROS messages, from a pattern: `leg{leg}_J{joint}` names the Elkapod's leg1_J1 to leg6_J3."""

    def __init__(self, pattern: str = "joint_{leg}{joint}") -> None:
        """The default names are the URDF's. Raises JointsError if the pattern does not give each joint its own name."""
        if not _PATTERN.fullmatch(pattern):
            raise JointsError(f"{pattern[:80]!r} is no pattern of joint names, such as leg{{leg}}_J{{joint}}")
        self._names = {
            servo_id: pattern.replace("{leg}", str(servo_id // 10)).replace("{joint}", str(servo_id % 10))
            for servo_id in SERVO_IDS
        }
        self._servos = {name: servo_id for servo_id, name in self._names.items()}
        if len(self._servos) < len(SERVO_IDS):
            raise JointsError(f"{pattern!r} gives two joints one name: it needs {{leg}} and {{joint}}")

    def of(self, servo_id: int) -> str:
        """Return the name of a servo's joint."""
        return self._names[servo_id]

    def servos(self, names: Sequence[str]) -> tuple[int, ...]:
        """Return the joints' servos in order. Raises JointsError if a name is unknown or a leg is incomplete."""
        if not names:
            raise JointsError("it names no joint")
        for name in names:
            if name not in self._servos:
                first, *_, last = self._servos
                raise JointsError(f"there is no joint {name[:64]!r}; they are {first} to {last}, leg and then joint")
            if names.count(name) > 1:
                raise JointsError(f"it names {name} twice")
        servos = tuple(self._servos[name] for name in names)
        for servo_id, joint in product(servos, JOINTS):
            leg = servo_id // 10
            if 10 * leg + joint not in servos:
                raise JointsError(f"of leg {leg} it lacks {self.of(10 * leg + joint)}; a leg is commanded as a whole")
        return servos


def positions_of(servos: Sequence[int], positions: Sequence[float]) -> dict[int, float]:
    """Return servo → position. Raises JointsError if one is missing or not finite."""
    if len(positions) != len(servos):
        raise JointsError(f"there must be one position for each of {len(servos)} joints, not {len(positions)}")
    found = dict(zip(servos, positions, strict=True))
    for servo_id, position in found.items():
        if not math.isfinite(position):
            raise JointsError(f"the position of {joint_name(servo_id)} is {position}")
    return found


def check_reach(geometry: Geometry, at_rad: Mapping[int, float]) -> None:
    """Raise JointsError if a servo would leave 0 to 180°."""
    for servo_id, position in at_rad.items():
        angle_deg = geometry.servos[servo_id].servo_deg(position)
        if not 0.0 <= angle_deg <= MAX_DEG:
            raise JointsError(
                f"{joint_name(servo_id)} at {position:.4g} rad is {angle_deg:.4g}° of its servo, which has 0 to 180°"
            )


def legs_deg(geometry: Geometry, at_rad: Mapping[int, float]) -> dict[int, Angles]:
    """Return leg → degrees of its servos, clamped to 0 to 180."""
    deg = {name: min(max(geometry.servos[name].servo_deg(at), 0.0), MAX_DEG) for name, at in at_rad.items()}
    return {leg: (deg[10 * leg + 1], deg[10 * leg + 2], deg[10 * leg + 3]) for leg in LEGS if 10 * leg + 1 in deg}
