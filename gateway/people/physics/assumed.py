"""Assumed values of the simulated body that were never measured on the robot, and the ground. Pure."""

from contextlib import suppress
from typing import Any, Final, NamedTuple, Self

from gateway.errors import ConfigError
from gateway.geometry.model import TOTAL_KG

MASS_KG: Final = round(TOTAL_KG, 2)
"""An assumption (gateway/geometry/model.py). The Elkapod's own description adds up to 5.03 kg."""
TORQUE_NM: Final = 2.0
"""A servo of 20 kg·cm, the usual one in robots of this size. (An MG996R has 9.4 kg·cm at 4.8 V.)"""
FRICTION: Final = 0.8
"""Rubber on wood; the Elkapod's own simulation has the same for its feet."""
MAX_SLOPE_DEG: Final = 45.0
MAX_ROUGH_M: Final = 0.2
"""The roughest ground: as high as the robot stands."""
_KINDS: Final = {
    "rough": ("rough_m", 0.0, MAX_ROUGH_M),
    "step": ("step_m", -MAX_ROUGH_M, MAX_ROUGH_M),
    "slope": ("slope_deg", -MAX_SLOPE_DEG, MAX_SLOPE_DEG),
}
"""By word: the field of `Terrain`, its least and its greatest value."""


class Terrain(NamedTuple):
    """The ground: level, rising ahead of the robot, bumpy, or with a step."""

    slope_deg: float = 0.0
    rough_m: float = 0.0
    """The greatest height of its bumps."""
    step_m: float = 0.0
    """The height of a step ahead of the robot; below 0 the ground drops there."""

    @classmethod
    def parsed(cls, text: str) -> Self:
        """Read `flat`, `slope:DEGREES`, `rough:METRES` or `step:METRES`. Raises ConfigError for any other text."""
        if text == "flat":
            return cls()
        kind, _, number = text.partition(":")
        with suppress(KeyError, ValueError):
            field, least, most = _KINDS[kind]
            amount: Any = float(number)
            if least <= amount <= most:
                return cls(**{field: amount})
        raise ConfigError(
            f"{text!r} is no terrain; there are flat, slope:DEGREES (up to {MAX_SLOPE_DEG:g}, below 0 downhill), "
            f"rough:METRES (bumps of up to {MAX_ROUGH_M:g}) and step:METRES (up to {MAX_ROUGH_M:g}, below 0 an edge)"
        )

    def __str__(self) -> str:
        amounts = ((kind, getattr(self, field)) for kind, (field, _, _) in _KINDS.items())
        return next((f"{kind}:{amount:g}" for kind, amount in amounts if amount), "flat")


class Assumed(NamedTuple):
    """Values that were never measured on the robot, and the ground."""

    mass_kg: float = MASS_KG
    """Mass of the whole robot; its parts keep their shares."""
    torque_nm: float = TORQUE_NM
    friction: float = FRICTION
    terrain: Terrain = Terrain()


USUAL: Final = Assumed()


def assumed(mass_kg: float | None, torque_nm: float | None, friction: float | None, terrain: str | None) -> Assumed:
    """Return these values; None means the default. Raises ConfigError if `terrain` cannot be read."""
    given = {"mass_kg": mass_kg, "torque_nm": torque_nm, "friction": friction}
    known = {name: value for name, value in given.items() if value is not None}
    return Assumed(**known, terrain=Terrain() if terrain is None else Terrain.parsed(terrain))
