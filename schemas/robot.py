"""The robot's legs, joints and servos, for keys and frames alike."""

from typing import Final

LEGS: Final = range(1, 7)
JOINTS: Final = range(1, 4)
"""The joints, from the body outward."""
SERVO_IDS: Final[tuple[int, ...]] = tuple(10 * leg + joint for leg in LEGS for joint in JOINTS)
"""Leg, then joint: 11 to 63."""
MAX_DEG: Final = 180.0
"""A servo's greatest angle; the least is 0."""
