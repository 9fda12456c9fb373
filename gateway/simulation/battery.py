"""The battery of a simulated robot: its voltage sags under load, and falls as it empties. Pure.

Assumed, since nobody has measured the robot's: two lithium cells, of the size and the wires of a hobby robot.
"""

from typing import Final

FULL_V: Final = 8.4
EMPTY_V: Final = 6.4
"""Two cells at rest: 4.2 V each, and 3.2 V, where a pack is switched off."""
RESISTANCE_OHM: Final = 0.06
"""Of the pack, its plug and its wires."""
CAPACITY_AS: Final = 5.0 * 3600

BASE_A: Final = 1.0
"""The computer and the controller, whatever the servos do."""


class SimulatedBattery:
    """`charge`: 1 full, 0 empty."""

    def __init__(self, charge: float = 1.0) -> None:
        self.charge = charge
        self.current_a = BASE_A

    def draw(self, current_a: float, seconds: float) -> None:
        """So much current has flowed for so long, and flows now."""
        self.current_a = current_a
        self.charge = max(0.0, self.charge - current_a * seconds / CAPACITY_AS)

    @property
    def voltage_v(self) -> float:
        """At its plug, under the load of now."""
        return EMPTY_V + (FULL_V - EMPTY_V) * self.charge - RESISTANCE_OHM * self.current_a

    @property
    def percent(self) -> float:
        """By the voltage, as simple boards count it: it falls under load, and comes back."""
        return max(0.0, min(100.0, 100 * (self.voltage_v - EMPTY_V) / (FULL_V - EMPTY_V)))
