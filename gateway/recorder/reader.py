"""Reads a ring that may be written to meanwhile, cut off, damaged or made by somebody else: it trusts nothing.

It holds a copy of the file, never more than `form.file_bytes(place.MAX_SLOTS)`: a mapping would end the reader with
SIGBUS where somebody makes the file shorter.
"""

import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from gateway.errors import GatewayError
from gateway.recorder import format as form
from gateway.recorder.decoding import decode
from gateway.recorder.place import MAX_SLOTS
from gateway.recorder.ring import written_by_anyone

MAX_BYTES: Final = form.file_bytes(MAX_SLOTS)


class NoRingError(GatewayError):
    """There is no black box to read."""


@dataclass(frozen=True, slots=True)
class Content:
    """What a ring holds, oldest first."""

    records: tuple[form.Record, ...]
    damaged: int
    """Slots that hold no whole record, or one of a wrong place."""
    missing: int
    """Sequence numbers that no slot has, between the oldest and the newest."""
    written: bool
    """Whether a gateway writes to it now."""


def read(path: Path) -> Content:
    """All whole records of a ring. Raises NoRingError."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError as error:
        raise NoRingError(f"{path}: {error.strerror}") from error
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode) or found.st_size > MAX_BYTES:
            raise NoRingError(f"{path}: it is no black box")
        written = written_by_anyone(fd)  # first: a gateway that ends meanwhile has written all
        with os.fdopen(fd, "rb", closefd=False) as file:
            data = file.read(found.st_size)
    except OSError as error:
        raise NoRingError(f"{path}: {error.strerror}") from error
    finally:
        os.close(fd)
    try:
        records, damaged, missing = parse(data)
    except form.DamagedError as error:
        raise NoRingError(f"{path}: {error}") from error
    return Content(records, damaged, missing, written)


def parse(data: bytes) -> tuple[tuple[form.Record, ...], int, int]:
    """The records in a file's bytes, oldest first; how many slots are damaged and how many missing.

    Raises DamagedError.
    """
    slots = form.slots_of(data[: form.HEADER_BYTES], len(data))
    found: dict[int, form.Slot] = {}
    damaged = 0
    for index in range(slots):
        begin = form.HEADER_BYTES + index * form.SLOT
        raw = data[begin : begin + form.SLOT]
        slot = form.read_slot(raw)
        if slot is not None and slot.sequence and slot.sequence % slots == index:
            found[slot.sequence] = slot
        elif any(raw):
            damaged += 1
    newest = max(found, default=0)
    # What is more than a round behind was overwritten in part: a slot that was left over says nothing.
    kept = sorted(number for number in found if number > newest - slots)
    records: list[form.Record] = []
    for number in kept:
        slot = found[number]
        if slot.kind == form.MORE:
            continue
        try:
            content = decode(slot.kind, _whole(slot, found))
        except form.DamagedError:
            damaged += 1
            continue
        if content is not None:
            records.append(form.Record(number, slot.ns, content))
    missing = newest - kept[0] + 1 - len(kept) if kept else 0
    return tuple(records), damaged, missing


def _whole(slot: form.Slot, found: dict[int, form.Slot]) -> bytes:
    """A record's content with what continues it."""
    rest, last = slot.rest, slot
    while last.more:
        following = found.get(last.sequence + 1)
        if following is None or following.kind != form.MORE or len(rest) > form.MAX_TEXT:
            raise form.DamagedError("a continued record is cut off")
        rest += following.rest
        last = following
    return rest
