"""What the black box's folder contains, how large its ring may be, and where its copies are."""

import re
from pathlib import Path
from typing import Final

RING_FILE: Final = "black-box"
"""A link to the ring, which is in memory."""

MAX_SLOTS: Final = 500_000
"""64 MB of memory. More than 60 s at 1000 frames a second and leg, or 600 s at 125, do not fit in it."""

COPIED_SHARE: Final = 8
"""A copy has an eighth of the ring's records: 10 s of six legs at their rate, with either framing; 7.5 s of a flood."""
MOST_COPIES: Final = 8
"""The newest are kept: together as large as the ring."""


def copy_path(ring: Path, newest: int) -> Path:
    """The copy of a ring's records up to the sequence number `newest`."""
    return ring.with_name(f"{ring.name}.{newest:019d}")


def copies_of(ring: Path) -> list[Path]:
    """The copies beside a ring, oldest first. Raises OSError."""
    name = re.compile(rf"{re.escape(ring.name)}\.\d{{19}}", re.ASCII)
    return sorted(path for path in ring.parent.iterdir() if name.fullmatch(path.name))
