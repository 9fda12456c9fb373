"""The ring of records: a memory-mapped file that survives its process.

The pages of a shared mapping belong to the file, so they survive SIGKILL. Writing a record copies it into memory,
without a system call or a page fault: all pages are mapped at opening.

The file must be in memory (tmpfs). On a disk, the first write to a page after each write-back blocks while the disk is
busy, which would delay a Stop (measured: docs/recordings.md).
"""

import fcntl
import mmap
import os
import stat
from contextlib import suppress
from pathlib import Path
from zlib import crc32

from gateway.host.file_lock import lock
from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.model.black_box.format import HEAD_BYTES, pack_head, pack_slot_into
from gateway.model.black_box.header import copies_of

_HEADER, _SLOT, _ROOM = form.HEADER_BYTES, form.SLOT, form.ROOM


class RecordRing:
    """The writer's side. Not thread-safe."""

    def __init__(self, path: Path, slots: int) -> None:
        """Open the file. If it has another version or size, begin it anew. Raises OSError, also for another's file."""
        self.note = ""
        """A sentence about a file that was begun anew or is damaged, else ""."""
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        self._fd = os.open(path, flags, 0o600)
        try:
            _check_owner(self._fd, path)
            try:
                lock(self._fd, fcntl.F_WRLCK)
            except OSError as error:
                raise OSError(error.errno, "another gateway writes to it") from error
            size = header.file_bytes(slots)
            whole = self._is_whole(slots)
            if not whole:
                os.ftruncate(self._fd, 0)
                for copy in copies_of(path):  # they have sequence numbers of another ring
                    with suppress(OSError):
                        copy.unlink()
            # Allocate all blocks: with a hole and a full disk, a later write would end in SIGBUS.
            os.posix_fallocate(self._fd, 0, size)
            self._map = mmap.mmap(self._fd, size, flags=mmap.MAP_SHARED | getattr(mmap, "MAP_POPULATE", 0))
        except BaseException:
            os.close(self._fd)
            raise
        self._slots = slots
        if not whole:
            self._map[: form.HEADER_BYTES] = header.new(slots)
        newest, torn = form.newest(self._map, slots)
        if newest and torn:
            self.note = f"the black box continues; {torn} of its newest records are incomplete"
        self.sequence = newest + 1
        """Number of the next record."""

    def append(self, kind: int, ns: int, rest: bytes) -> None:
        """Write a record, in several slots if it does not fit in one."""
        part, more = rest[:_ROOM], len(rest) > _ROOM
        self.put(pack_head(len(part) + HEAD_BYTES, kind, more, self.sequence, ns) + part)
        if more:
            self.append(form.MORE, ns, rest[_ROOM:])

    def put(self, body: bytes) -> None:
        """Write a one-slot record. `body` begins with its head, which has the number `sequence`."""
        sequence = self.sequence
        pack_slot_into(self._map, _HEADER + sequence % self._slots * _SLOT, crc32(body), body)
        self.sequence = sequence + 1

    @property
    def calibration(self) -> bytes:
        """The header's calibration, as JSON; empty: none."""
        return header.calibration(self._map[: form.HEADER_BYTES])

    @calibration.setter
    def calibration(self, data: bytes) -> None:
        header.put_calibration(self._map, data)

    def close(self) -> None:
        """Unmap and close the file; its content stays."""
        self._map.close()
        os.close(self._fd)

    def _is_whole(self, slots: int) -> bool:
        size = os.fstat(self._fd).st_size
        if size == 0:
            return False
        try:
            found = header.slots_of(os.pread(self._fd, form.HEADER_BYTES, 0), size)
        except form.DamagedRingError as error:
            self.note = f"the black box starts empty: {error}"
            return False
        if found != slots:
            self.note = f"the black box starts empty: it has {found} records, and the settings want {slots}"
        return found == slots


def _check_owner(fd: int, path: Path) -> None:
    """Raise PermissionError for another user's file, which may be planted in a folder such as /dev/shm."""
    found = os.fstat(fd)
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_nlink != 1:
        raise PermissionError(f"{path} belongs to another user")
