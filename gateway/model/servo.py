"""Figures of the simulated servos: an MG996R, as in the Elkapod's drawings."""

from typing import Final

NO_LOAD_DEG_S: Final = 60 / 0.17
"""The servo's speed without load at 4.8 V: 60° in 0.17 s."""

IDLE_A: Final = 0.01
MOVING_A: Final = 0.25
A_PER_NM: Final = 1.25
"""A hobby servo's current at rest and in motion without load, and the current that a load adds (assumed, not measured
on the robot). A servo stalled at 2 N·m draws 2.5 A."""
