"""The servo of the Elkapod's drawings, an MG996R."""

from typing import Final

NO_LOAD_DEG_S: Final = 60 / 0.17
"""At 4.8 V it takes 0.17 s for 60°."""

IDLE_A: Final = 0.01
MOVING_A: Final = 0.25
A_PER_NM: Final = 1.25
"""Assumed, since nobody has measured the robot's: what a hobby servo takes that holds without load, what one takes that
moves without load, and what a load adds. One of 2 N·m takes 2.5 A when it stalls."""
