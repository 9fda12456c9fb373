"""What a robot of this geometry weighs: assumptions, for its balance and for simulations. Pure.

Nobody has weighed the Elkapod. A hobby servo with its horn and screws has about 60 g; a leg carries three, of which the
first is in the body. The rest are plates, a computer and a battery.
"""

from typing import Final, NamedTuple


class Masses(NamedTuple):
    """Kilograms; each part's mass is spread evenly over its box in the URDF."""

    body_kg: float = 1.30
    coxa_kg: float = 0.09
    femur_kg: float = 0.09
    tibia_kg: float = 0.05

    @property
    def links_kg(self) -> tuple[float, float, float]:
        """Of a leg's links, from the body outward."""
        return self.coxa_kg, self.femur_kg, self.tibia_kg

    @property
    def total_kg(self) -> float:
        """The whole robot."""
        return self.body_kg + 6 * sum(self.links_kg)


MASSES: Final = Masses()
