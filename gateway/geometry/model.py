"""A validated geometry file: mounts and joints in metres and radians, servos in degrees."""

import math
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from gateway.errors import ConfigError
from gateway.files import durable
from schemas.robot import LEGS, SERVO_IDS

ELKAPOD: Final = Path(__file__).with_name("elkapod.json")
"""The default robot."""

MAX_FILE_BYTES: Final = 1_000_000
"""The default file has 4000. The limit keeps a recording, given by mistake, from being read whole."""

MAX_SPEED_DEG_S: Final = 300.0
"""The speed of a servo without one in the settings. An MG996R without load reaches 353."""

MAX_M: Final = 100.0
"""Longer than any robot: a larger number is in other units."""

Metres = Annotated[float, Field(ge=-MAX_M, le=MAX_M, allow_inf_nan=False)]
Radians = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi, allow_inf_nan=False)]
Vector = tuple[Metres, Metres, Metres]


class Part(BaseModel):
    """Base of all parts of the file. Frozen; unknown fields, such as remarks, are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class Mount(Part):
    """Origin of a leg in the body's frame: x forward, y left, z up. The leg's own x points outward."""

    xyz_m: Vector
    yaw_rad: Radians


class Joint(Part):
    """A joint in the previous joint's frame (the first: in the mount's)."""

    origin_xyz_m: Vector
    origin_rpy_rad: tuple[Radians, Radians, Radians]
    axis: tuple[float, float, float]
    limits_rad: tuple[Radians, Radians]

    @field_validator("axis")
    @classmethod
    def _points_somewhere(cls, axis: tuple[float, float, float]) -> tuple[float, float, float]:
        length = math.hypot(*axis)
        if not 0.99 < length < 1.01:
            raise ValueError("an axis has the length 1, such as [0, 0, 1]")
        return axis


class Foot(Part):
    """The point that touches the ground, in the frame of the third joint."""

    origin_xyz_m: Vector


class JointServo(Part):
    """Relation of a servo's angle to its joint's: `zero_deg` at joint angle 0, and the direction."""

    zero_deg: Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]
    direction: Literal[1, -1]

    def joint_rad(self, servo_deg: float) -> float:
        """Return the joint's angle with the servo at `servo_deg`."""
        return math.radians(servo_deg - self.zero_deg) * self.direction

    def servo_deg(self, joint_rad: float) -> float:
        """Return the servo's angle with the joint at `joint_rad`. The servo reaches only 0 to 180."""
        return self.zero_deg + self.direction * math.degrees(joint_rad)


class Geometry(Part):
    """One robot: six legs with the same chain of three joints and a foot."""

    name: Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[\w. -]+$")] = "hexapod"
    leg_mounts: dict[int, Mount]
    chain: tuple[Joint, Joint, Joint, Foot]
    servos: dict[int, JointServo]

    @field_validator("leg_mounts")
    @classmethod
    def _six_legs(cls, mounts: dict[int, Mount]) -> dict[int, Mount]:
        if sorted(mounts) != list(LEGS):
            raise ValueError(f"there are six legs, 1 to 6; here are {_list(mounts)}")
        return mounts

    @field_validator("servos")
    @classmethod
    def _all_servos(cls, servos: dict[int, JointServo]) -> dict[int, JointServo]:
        missing, unknown = set(SERVO_IDS) - servos.keys(), servos.keys() - set(SERVO_IDS)
        if missing or unknown:
            raise ValueError(
                f"there are 18 servos, 11 to 63; missing: {_list(missing)}; no servo has the id: {_list(unknown)}"
            )
        return servos

    @property
    def middle_m(self) -> Vector:
        """The middle of the body's box, which reaches from mount to mount."""
        xs, ys, zs = zip(*(mount.xyz_m for mount in self.leg_mounts.values()), strict=True)
        return (max(xs) + min(xs)) / 2, (max(ys) + min(ys)) / 2, (max(zs) + min(zs)) / 2

    @property
    def joints(self) -> tuple[Joint, Joint, Joint]:
        """The three joints of a leg, from the body outward."""
        first, second, third, _ = self.chain
        return first, second, third

    @property
    def foot(self) -> Foot:
        """The foot, the same for each leg."""
        return self.chain[3]

    def joint_rad(self, servo_id: int, servo_deg: float) -> float:
        """Return the angle of a servo's joint with the servo at `servo_deg`. Raises KeyError for an unknown id."""
        return self.servos[servo_id].joint_rad(servo_deg)


def load(path: Path | None = None) -> Geometry:
    """Return the geometry in `path` (default: ELKAPOD). Raises ConfigError with a line for each of up to 10 faults."""
    found = path or ELKAPOD
    try:
        data = durable.read(found, MAX_FILE_BYTES)  # not from a FIFO, for whose writer it would wait
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise ConfigError(f"{found}: cannot be read ({why}); name a geometry file (JSON)") from error
    if data is None:
        raise ConfigError(f"{found}: there is no such file; name a geometry file (JSON)")
    try:
        return Geometry.model_validate_json(data)
    except ValidationError as error:
        faults = [
            f"{found}: {'.'.join(map(str, fault['loc'])) or 'the file'}: {fault['msg'].removeprefix('Value error, ')}"
            for fault in error.errors(include_url=False)
        ]
        raise ConfigError("\n".join(faults[:_MAX_FAULTS])) from error


_MAX_FAULTS: Final = 10


def _list(numbers: dict[int, Mount] | set[int]) -> str:
    return ", ".join(map(str, sorted(numbers)[:_MAX_FAULTS])) or "none"


BODY_KG: Final = 1.30
LINKS_KG: Final = (0.09, 0.09, 0.05)
"""The masses of the body and of one leg's links, from the body outward, each spread evenly over its box in the URDF."""
TOTAL_KG: Final = BODY_KG + 6 * sum(LINKS_KG)
