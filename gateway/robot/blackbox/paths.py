"""Paths of the black box: a folder on the disk for incidents, with a link to the ring in memory."""

import os
import zlib
from pathlib import Path
from typing import Final

from gateway.host.directories import runtime_directory, state_to_read, users_state
from gateway.model.black_box.header import MAX_SLOTS, RING_FILE
from gateway.robot.settings import Settings
from schemas.robot import LEGS

RECORDS_PER_FRAME: Final = 4
"""A setpoint makes one record, or two if a frame is two transfers. A stream above the rate limit makes twice as many,
for coalesced commands and their Decisions."""
OTHER_RECORDS_PER_S: Final = 100


RING_S: Final = 60.0
"""The copy of an incident needs the 10 s before it; recordings are for more than a minute."""
REACH_S: Final = 50.0
"""The ring keeps records of messages for this time, even in a flood: an incident begins 10 s back and lasts 30 s at
most. Other records are bounded by their own rates."""


def slots_for(settings: Settings) -> int:
    """Return the number of records in `RING_S` with all legs commanded at their rate."""
    per_s = RECORDS_PER_FRAME * len(LEGS) * settings.limits.leg_rate_hz + OTHER_RECORDS_PER_S
    return min(MAX_SLOTS, round(RING_S * per_s))


def client_records_a_second(settings: Settings) -> int:
    """Return how many records a second messages may make: those of all legs at their rate, if the ring has room."""
    room = slots_for(settings) / REACH_S - OTHER_RECORDS_PER_S
    return max(1, round(min(RECORDS_PER_FRAME * len(LEGS) * settings.limits.leg_rate_hz, room)))


def folder_to_read(settings: Settings) -> Path | None:
    """Return the folder for a reader: the gateway's own, else the service's, else that of `make run`, else None."""
    return state_to_read(settings.state.path) or (tried() if tried().is_dir() else None)


def tried() -> Path:
    """Return the folder of this user's `make run`, which readers find without a settings file."""
    return users_state() / "tried"


def prepare(folder: Path) -> Path:
    """Make a link in the folder to the ring, and return the ring's path. Raises OSError, also for a missing folder."""
    os.listdir(folder)
    place, link = in_memory(folder), folder / RING_FILE
    if place == link:
        return place
    if not link.is_symlink() or Path(os.readlink(link)) != place:
        new = link.with_suffix(".new")
        new.unlink(missing_ok=True)
        new.symlink_to(place)
        new.replace(link)
    return place


def in_memory(folder: Path) -> Path:
    """Return a path in memory for this folder's ring, or in the folder itself if the system has none."""
    runtime = runtime_directory()
    if runtime is not None:
        return runtime / RING_FILE
    name = f"hexapod-gateway-{os.geteuid()}-{zlib.crc32(bytes(folder.resolve())):08x}"
    for candidate in (os.environ.get("XDG_RUNTIME_DIR", ""), "/dev/shm"):  # noqa: S108  the owner is checked
        if candidate and os.access(candidate, os.W_OK):
            return Path(candidate) / name
    return folder / RING_FILE
