"""The ring of records: a memory-mapped file that survives its process; its size, and its folder.

The pages of a shared mapping belong to the file, so they survive SIGKILL. Writing a record copies it into memory,
without a system call or a page fault: all pages are mapped at opening.

The file must be in memory (tmpfs). On a disk, the first write to a page after each write-back blocks while the disk is
busy, which would delay a Stop (measured: docs/recordings.md).
"""

import errno
import fcntl
import mmap
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Final
from zlib import crc32

from gateway.host.directories import runtime_directory, state_to_read, users_state
from gateway.host.file_lock import lock
from gateway.model import black_box as form
from gateway.model.black_box import HEAD_BYTES, HEADER_BYTES, RING_FILE, ROOM, SLOT, pack_head, pack_slot_into
from gateway.robot.settings import Settings
from schemas.robot import LEGS

RECORDS_PER_FRAME: Final = 4
"""A setpoint of a leg makes one record, or three if its frame leaves in a later step. A stream above the rate limit
makes more, for commands that newer ones replace."""
OTHER_RECORDS_PER_S: Final = 100

RING_S: Final = 60.0
"""The copy of an incident needs the 10 s before it; recordings are for more than a minute."""
REACH_S: Final = 50.0
"""The ring keeps records of messages for this time, even in a flood: an incident begins 10 s back and lasts 30 s at
most. Other records are bounded by their own rates."""


class RecordRing:
    """The writer's side. Not thread-safe."""

    def __init__(self, path: Path, slots: int) -> None:
        """Open the file. If it has another version or size, begin it anew. Raises OSError, also for another's file."""
        self.note = ""
        """A sentence about a file that was begun anew, else ""."""
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        self._fd = os.open(path, flags, 0o600)
        try:
            if not lock(self._fd, fcntl.F_WRLCK):
                raise BlockingIOError(errno.EAGAIN, "another gateway writes to it")
            found = os.fstat(self._fd)
            if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_nlink != 1:
                raise PermissionError("it belongs to another user")  # it may be planted, such as in /dev/shm
            size = form.file_bytes(slots)
            whole = found.st_size == size and os.pread(self._fd, HEADER_BYTES, 0) == form.new_header(slots)
            if not whole:
                self.note = "the black box starts empty: its file is of another version or size" * bool(found.st_size)
                os.ftruncate(self._fd, 0)
                for copy in form.copies_of(path):  # they have sequence numbers of another ring
                    with suppress(OSError):
                        copy.unlink()
            # Allocate all blocks: with a hole and a full disk, a later write would end in SIGBUS.
            try:
                os.posix_fallocate(self._fd, 0, size)
            except OSError:
                os.ftruncate(self._fd, 0)  # readers then state that there was no room
                raise
            self._map = mmap.mmap(self._fd, size, flags=mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
        except BaseException:
            os.close(self._fd)
            raise
        self._slots = slots
        if not whole:
            self._map[:HEADER_BYTES] = form.new_header(slots)
        self.sequence = form.newest(self._map, slots) + 1
        """Number of the next record."""

    def append(self, kind: int, ns: int, rest: bytes, more: int = 0) -> None:
        """Write a record, in several slots if it does not fit in one. `more`: the next record continues it."""
        while len(rest) > ROOM:
            self.append(kind, ns, rest[:ROOM], 1)
            kind, rest = form.MORE, rest[ROOM:]
        sequence = self.sequence
        body = pack_head(len(rest) + HEAD_BYTES, kind, more, sequence, ns) + rest
        pack_slot_into(self._map, HEADER_BYTES + sequence % self._slots * SLOT, crc32(body), body)
        self.sequence = sequence + 1

    def close(self) -> None:
        """Unmap and close the file; its content stays."""
        self._map.close()
        os.close(self._fd)


# ---- size and folder


def slots_for(settings: Settings) -> int:
    """Return the number of records in `RING_S` with all legs commanded at their rate."""
    per_s = RECORDS_PER_FRAME * len(LEGS) * settings.limits.leg_rate_hz + OTHER_RECORDS_PER_S
    return min(form.MAX_SLOTS, round(RING_S * per_s))


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
    """Make a link in the folder to the ring, and return the ring's path. Raises OSError, also for a missing folder.

    The ring is in memory, or in the folder itself if no folder in memory can be written. In /dev/shm another user may
    have taken its name; then it gets another name, which the link keeps.
    """
    os.listdir(folder)
    link, runtime = folder / RING_FILE, runtime_directory()
    name = f"hexapod-gateway-{os.geteuid()}-{crc32(bytes(folder.resolve())):08x}"
    places = (os.environ.get("XDG_RUNTIME_DIR", ""), "/dev/shm")  # noqa: S108  the owner is checked
    in_memory = (Path(each) / name for each in places if each and os.access(each, os.W_OK))
    place = next(in_memory, link) if runtime is None else runtime / RING_FILE
    if place != link and _foreign(place):
        before = Path(os.readlink(link)) if link.is_symlink() else link
        kept = before.parent == place.parent and before.name.startswith(name) and not _foreign(before)
        place = before if kept else place.with_name(f"{name}-{os.urandom(4).hex()}")
    if place == link and link.is_symlink():
        link.unlink()
    if place != link and (not link.is_symlink() or Path(os.readlink(link)) != place):
        new = link.with_suffix(".new")
        new.unlink(missing_ok=True)
        new.symlink_to(place)
        new.replace(link)
    return place


def _foreign(path: Path) -> bool:
    """Return whether something is at `path` that is no file of this user's."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return False
    return not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_nlink != 1
