"""The robot's numbers, in one place for keys and frames alike."""

from typing import Final

LEGS: Final = range(1, 7)
JOINTS: Final = range(1, 4)
"""Counted from the body outward."""
SERVO_IDS: Final[tuple[int, ...]] = tuple(10 * leg + joint for leg in LEGS for joint in JOINTS)
"""A servo's id is its leg, then its joint: 11 to 63."""
