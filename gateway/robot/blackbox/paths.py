"""Where the black box is: a folder on the disk for incidents, with a link to the ring, which is in memory."""

import os
import zlib
from pathlib import Path
from typing import Final

from gateway.robot.host.directories import SERVICE_STATE, runtime_directory, state_directory
from gateway.robot.settings import Settings

RING: Final = "black-box"
INCIDENTS: Final = "incidents"

RECORDS_PER_FRAME: Final = 4
"""A setpoint makes one record, or two, where a frame is two transfers: the command, and the frame that it was accepted
with. Twice as many come in a stream above the limit, for commands that are replaced and what becomes of them."""
OTHER_RECORDS_PER_S: Final = 100
MAX_SLOTS: Final = 500_000
"""64 MB of memory. More than 60 s at 1000 frames a second and leg, or 600 s at 125, do not fit in it."""
LEGS: Final = 6


def slots_for(settings: Settings) -> int:
    """How many records reach back `recorder.seconds` while all legs are commanded at their rate."""
    per_s = RECORDS_PER_FRAME * LEGS * settings.limits.leg_rate_hz + OTHER_RECORDS_PER_S
    return min(MAX_SLOTS, round(settings.recorder.seconds * per_s))


def folder_of(settings: Settings) -> Path | None:
    """The black box's folder for the gateway itself; None: it is off."""
    if settings.recorder.path:
        return Path(settings.recorder.path)
    return state_directory()


def folder_to_read(settings: Settings) -> Path | None:
    """The same for whoever reads it: also the service's, or else that of `make run`, where no setting names one."""
    folder = folder_of(settings)
    if folder is not None:
        return folder
    return next((each for each in (SERVICE_STATE, tried()) if each.is_dir()), None)


def tried() -> Path:
    """The black box of `make run`, this user's own; it is found without a file of settings."""
    state = os.environ.get("XDG_STATE_HOME")
    return (Path(state) if state else Path("~/.local/state").expanduser()) / "hexapod-gateway" / "tried"


def prepare(folder: Path) -> Path:
    """Make the folder, and in it a link to where the ring is to be; returns that place. Raises OSError."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    place, link = in_memory(folder), folder / RING
    if place == link:
        return place
    if not link.is_symlink() or Path(os.readlink(link)) != place:
        new = link.with_suffix(".new")
        new.unlink(missing_ok=True)
        new.symlink_to(place)
        new.replace(link)
    return place


def in_memory(folder: Path) -> Path:
    """A place in memory for the ring of this folder; where a system has none, the folder itself."""
    runtime = runtime_directory()
    if runtime is not None:
        return runtime / RING
    name = f"hexapod-gateway-{os.geteuid()}-{zlib.crc32(bytes(folder.resolve())):08x}"
    for candidate in (os.environ.get("XDG_RUNTIME_DIR", ""), "/dev/shm"):  # noqa: S108  the owner is checked
        if candidate and os.access(candidate, os.W_OK):
            return Path(candidate) / name
    return folder / RING
