"""Assumed values of the simulated body that were never measured on the robot, and the ground. Pure."""

import math
from typing import Final, NamedTuple, Self

from gateway.errors import ConfigError
from gateway.geometry.model import MASSES

MASS_KG: Final = round(MASSES.total_kg, 2)
"""An assumption (gateway/geometry/model.py). The Elkapod's own description adds up to 5.03 kg."""
TORQUE_NM: Final = 2.0
"""A servo of 20 kg·cm, the usual one in robots of this size. (An MG996R has 9.4 kg·cm at 4.8 V.)"""
FRICTION: Final = 0.8
"""Rubber on wood; the Elkapod's own simulation has the same for its feet."""
MAX_SLOPE_DEG: Final = 45.0
MAX_ROUGH_M: Final = 0.2
"""The roughest ground: as high as the robot stands."""


class Terrain(NamedTuple):
    """The ground: level, rising ahead of the robot, bumpy, or with a step."""

    slope_deg: float = 0.0
    rough_m: float = 0.0
    """The greatest height of its bumps."""
    seed: int = 0
    """Selects the bumps; `parsed` always uses 0."""
    step_m: float = 0.0
    """The height of a step ahead of the robot; below 0 the ground drops there."""

    @classmethod
    def parsed(cls, text: str) -> Self:
        """Read `flat`, `slope:DEGREES`, `rough:METRES` or `step:METRES`. Raises ConfigError for any other text."""
        kind, colon, number = text.partition(":")
        try:
            amount = float(number) if colon else 0.0
        except ValueError:
            amount = math.nan
        if text == "flat":
            return cls()
        if kind == "slope" and colon and abs(amount) <= MAX_SLOPE_DEG:
            return cls(slope_deg=amount)
        if kind == "rough" and colon and 0 <= amount <= MAX_ROUGH_M:
            return cls(rough_m=amount)
        if kind == "step" and colon and abs(amount) <= MAX_ROUGH_M:
            return cls(step_m=amount)
        raise ConfigError(
            f"{text!r} is no terrain; there are flat, slope:DEGREES (up to {MAX_SLOPE_DEG:g}, below 0 downhill), "
            f"rough:METRES (bumps of up to {MAX_ROUGH_M:g}) and step:METRES (up to {MAX_ROUGH_M:g}, below 0 an edge)"
        )

    def __str__(self) -> str:
        if self.rough_m:
            return f"rough:{self.rough_m:g}"
        if self.step_m:
            return f"step:{self.step_m:g}"
        return f"slope:{self.slope_deg:g}" if self.slope_deg else "flat"


FLAT: Final = Terrain()


class Assumed(NamedTuple):
    """Values that were never measured on the robot, and the ground."""

    mass_kg: float = MASS_KG
    """Mass of the whole robot; its parts keep their shares."""
    torque_nm: float = TORQUE_NM
    friction: float = FRICTION
    terrain: Terrain = FLAT


USUAL: Final = Assumed()


def assumed(mass_kg: float | None, torque_nm: float | None, friction: float | None, terrain: str | None) -> Assumed:
    """Return these values; None means the default. Raises ConfigError if `terrain` cannot be read."""
    return Assumed(
        USUAL.mass_kg if mass_kg is None else mass_kg,
        USUAL.torque_nm if torque_nm is None else torque_nm,
        USUAL.friction if friction is None else friction,
        USUAL.terrain if terrain is None else Terrain.parsed(terrain),
    )
