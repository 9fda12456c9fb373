"""Assumed masses of a robot of this geometry, for its balance and for simulations. Pure.

Nobody has weighed the Elkapod. A hobby servo with its horn and screws has about 60 g; a leg carries three, of which the
first is in the body. The rest are plates, a computer and a battery.

The robot's own description (HexapodBionik/elkapod_core, elkapod_description/urdf) adds up to 5.03 kg, by CAD: the body
with its plates 2.00, control module 0.44, lidar 0.30, camera 0.06, grilles 0.13; and for each leg 0.081 in the body,
coxa 0.043, femur 0.169, tibia 0.046, foot 0.011. The servos of its drawings (MG996R, some 1 N·m) do not lift that
(`run --sim=physics --mass-kg 5.03 --servo-torque-nm 1`), so mass or servo is another's, and a lighter robot is assumed.
"""

from typing import Final, NamedTuple


class Masses(NamedTuple):
    """Each part's mass is spread evenly over its box in the URDF."""

    body_kg: float = 1.30
    coxa_kg: float = 0.09
    femur_kg: float = 0.09
    tibia_kg: float = 0.05

    @property
    def links_kg(self) -> tuple[float, float, float]:
        """The links of one leg, from the body outward."""
        return self.coxa_kg, self.femur_kg, self.tibia_kg

    @property
    def total_kg(self) -> float:
        """The mass of the body and all 18 links."""
        return self.body_kg + 6 * sum(self.links_kg)


MASSES: Final = Masses()
