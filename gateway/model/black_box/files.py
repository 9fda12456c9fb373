"""What the black box's folder contains, and how large its ring may be."""

from typing import Final

RING_FILE: Final = "black-box"
"""A link to the ring, which is in memory."""

MAX_SLOTS: Final = 500_000
"""64 MB of memory. More than 60 s at 1000 frames a second and leg, or 600 s at 125, do not fit in it."""
