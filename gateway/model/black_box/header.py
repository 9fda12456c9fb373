"""The files of the black box, and a ring's first page, the header.

| bytes   | content                                                                                       |
|---------|-----------------------------------------------------------------------------------------------|
| 0-27    | magic, version, the size of a slot, and how many there are                                    |
| 64-71   | used by earlier versions; not read                                                            |
| 128-133 | CRC-32 and length of the calibration; 0: none                                                 |
| 134-    | the calibration in force, since the ring overwrites its record                                |
"""

import re
import struct
import zlib
from pathlib import Path
from typing import Any, Final

from gateway.model.black_box.format import HEADER_BYTES, SLOT, DamagedRingError

VERSION: Final = 2
MAGIC: Final = b"hexapod black box\n"

_BEGIN: Final = struct.Struct("<18sHII")
_CALIBRATION: Final = struct.Struct("<IH")
_CALIBRATION_AT: Final = 128
_CALIBRATION_BEGIN: Final = _CALIBRATION_AT + _CALIBRATION.size


def new(slots: int) -> bytes:
    """Return the header of a new file."""
    return _BEGIN.pack(MAGIC, VERSION, SLOT, slots).ljust(HEADER_BYTES, b"\0")


def file_bytes(slots: int) -> int:
    """Return the size of a file in bytes, header included."""
    return HEADER_BYTES + slots * SLOT


def slots_of(head: bytes, size: int) -> int:
    """Return how many slots a file of `size` bytes with this head has. Raises DamagedRingError if they do not fit."""
    if len(head) < _BEGIN.size:
        raise DamagedRingError("it has no header")
    magic, version, slot, slots = _BEGIN.unpack_from(head)
    if magic != MAGIC:
        raise DamagedRingError("it is no black box")
    if version != VERSION or slot != SLOT:
        raise DamagedRingError(f"it has version {version}, with records of {slot} bytes")
    if not slots or size != file_bytes(slots):
        raise DamagedRingError(f"it has {size} bytes, and its header states {slots} records")
    return int(slots)


def put_calibration(buffer: Any, data: bytes) -> None:
    """Write the calibration in force, as JSON. One that does not fit counts as unknown."""
    if len(data) > HEADER_BYTES - _CALIBRATION_BEGIN:
        data = b""
    _CALIBRATION.pack_into(buffer, _CALIBRATION_AT, zlib.crc32(data), len(data))
    buffer[_CALIBRATION_BEGIN : _CALIBRATION_BEGIN + len(data)] = data


def calibration(head: bytes) -> bytes:
    """Return the bytes written by `put_calibration`; empty if there are none, or they are damaged."""
    if len(head) < HEADER_BYTES:
        return b""
    checksum, length = _CALIBRATION.unpack_from(head, _CALIBRATION_AT)
    data = head[_CALIBRATION_BEGIN : _CALIBRATION_BEGIN + length]
    return data if len(data) == length and zlib.crc32(data) == checksum else b""


RING_FILE: Final = "black-box"
"""A link to the ring, which is in memory."""

MAX_SLOTS: Final = 500_000
"""64 MB of memory: 60 s at 1000 frames a second and leg."""

COPIED_SHARE: Final = 8
"""A copy has an eighth of the ring's records: 10 s of six legs at their rate, with either framing; 7.5 s of a flood."""
MOST_COPIES: Final = 8
"""Copies that are kept, the newest: together as large as the ring."""


def copy_path(ring: Path, newest: int) -> Path:
    """Return the path of the copy of a ring's records up to the sequence number `newest`."""
    return ring.with_name(f"{ring.name}.{newest:019d}")


def copies_of(ring: Path) -> list[Path]:
    """Return the copies in a ring's folder, oldest first. Raises OSError."""
    name = re.compile(rf"{re.escape(ring.name)}\.\d{{19}}", re.ASCII)
    return sorted(path for path in ring.parent.iterdir() if name.fullmatch(path.name))
