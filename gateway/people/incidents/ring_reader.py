"""Reads a ring that may be written to meanwhile, cut off, damaged or made by somebody else: it trusts nothing.

It holds a copy of the file, never more than `header.file_bytes(MAX_SLOTS)`: a mapping would end the reader with
SIGBUS where somebody makes the file shorter. Besides, it holds some 26 bytes for each record: all of them as objects
would take eight times the file's size, more than the recorder's service may have (docs/blackbox.md).
"""

import os
import stat
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, overload

from gateway.errors import GatewayError
from gateway.host.file_lock import written_by_anyone
from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.model.black_box.files import MAX_SLOTS
from gateway.people.incidents.ring_decoding import decode
from schemas.calibration import Calibration

_MAX_BYTES: Final = header.file_bytes(MAX_SLOTS)
MOST_CHANGES: Final = 100
"""Of the calibration that a ring shows. A person makes one in half a minute."""
_KINDS_OF_PARTS: Final = (form.COMMAND, form.FRAME)
_EMPTY: Final = bytes(form.SLOT)
"""A slot that nobody has written yet: in a new file, nearly all of them."""


class NoRingError(GatewayError):
    """There is no black box to read."""


class Records(Sequence[form.Record]):
    """Records in the order in which they were written. Each is decoded when it is asked for."""

    def __init__(
        self,
        times_ns: Sequence[int],
        kinds: Sequence[int],
        read: Callable[[int], form.Record],
        calibration: Calibration | None = None,
    ) -> None:
        """`read` makes the record at a place from 0 on; their times and types are known without that.

        `calibration` was in force when the newest was written, as far as known.
        """
        self.times_ns = times_ns
        self.kinds = kinds
        self._read = read
        self._calibration = calibration

    def __len__(self) -> int:
        return len(self.times_ns)

    @overload
    def __getitem__(self, index: int) -> form.Record: ...
    @overload
    def __getitem__(self, index: slice) -> list[form.Record]: ...
    def __getitem__(self, index: int | slice) -> form.Record | list[form.Record]:
        if isinstance(index, slice):
            return [self._read(each) for each in range(*index.indices(len(self)))]
        return self._read(range(len(self))[index])

    def calibration_at(self, ns: int) -> Calibration | None:
        """What was in force then, as far as known."""
        found = None
        for since_ns, calibration in self._calibrations:
            if found is None or since_ns <= ns:
                found = calibration  # if all are later, the first: what was in force until then
        return found or self._calibration

    def about_at(self, ns: int) -> dict[str, Any]:
        """Versions and settings of the gateway that ran then; empty where they are not known."""
        found: dict[str, Any] = {}
        for index, kind in enumerate(self.kinds):
            if kind == form.START and self.times_ns[index] > ns:
                break
            if kind == form.START:
                found = {}
            elif kind == form.ABOUT and (not found or self.times_ns[index] <= ns):
                content = self[index].content
                found = content.facts if isinstance(content, form.About) else found
        return found

    @cached_property
    def _calibrations(self) -> list[tuple[int, Calibration]]:
        """The newest changes, oldest first, and since when each is in force."""
        places = deque((index for index, kind in enumerate(self.kinds) if kind == form.CALIBRATION), MOST_CHANGES)
        changes = [self[index] for index in places]
        return [(each.ns, each.content.calibration) for each in changes if isinstance(each.content, form.Calibrated)]

    def __iter__(self) -> Iterator[form.Record]:
        return map(self._read, range(len(self)))


@dataclass(frozen=True, slots=True)
class Content:
    """What a ring holds, oldest first."""

    records: Records
    damaged: int
    """Slots that hold no whole record, or one of a wrong place."""
    missing: int
    """Sequence numbers that no slot has, between the oldest and the newest."""
    written: bool
    """Whether a gateway writes to it now."""


def read(path: Path, most: int = MAX_SLOTS) -> Content:
    """All whole records of a ring, or those in its newest `most` slots. Raises NoRingError."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    except OSError as error:
        raise NoRingError(f"{path}: {error.strerror}") from error
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode) or found.st_size > _MAX_BYTES:
            raise NoRingError(f"{path}: it is no black box")
        _check_owner(found, path)
        written = written_by_anyone(fd)  # first: a gateway that ends meanwhile has written all
        with os.fdopen(fd, "rb", closefd=False) as file:
            data = file.read(found.st_size)
    except OSError as error:
        raise NoRingError(f"{path}: {error.strerror}") from error
    finally:
        os.close(fd)
    try:
        records, damaged, missing = parse(data, most)
    except form.DamagedRingError as error:
        raise NoRingError(f"{path}: {error}") from error
    return Content(records, damaged, missing, written)


def _check_owner(found: os.stat_result, path: Path) -> None:
    """In a folder such as /dev/shm anybody may have put the file where the link in ours leads. Raises NoRingError."""
    trusted = (path.lstat().st_uid, os.geteuid(), 0)
    if found.st_uid not in trusted or found.st_nlink != 1 or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise NoRingError(f"{path}: another user has made this file, or may write to it; it is not read")


def parse(data: bytes, most: int = MAX_SLOTS) -> tuple[Records, int, int]:
    """The records in a file's bytes, oldest first; how many slots are damaged and how many missing.

    With `most`, only the newest so many slots are looked at: a full look takes seconds.

    The bytes' length bounds its time and memory, whatever they say. Raises DamagedError.
    """
    slots = header.slots_of(data[: form.HEADER_BYTES], len(data))
    sequences = array("Q", bytes(slots * 8))  # of each slot's record; 0: it has none
    damaged = 0
    most = min(most, slots)
    newest = form.newest(data, slots)[0] if most < slots else 0
    looked_at = range(slots) if most == slots else range(max(1, newest - most + 1), newest + 1)
    for index in (each % slots for each in looked_at):
        raw = form.slot_bytes(data, index)
        if raw == _EMPTY:
            continue
        slot = form.read_slot(raw)
        if slot is not None and slot.sequence % slots == index:
            sequences[index] = slot.sequence
        else:
            damaged += 1
    newest = max(sequences)
    ring = _Slots(data, slots)
    numbers, parts, times_ns, kinds = array("Q"), bytearray(), array("q"), bytearray()
    oldest = kept = 0
    # What is more than a round behind was overwritten in part: a slot that was left over means nothing.
    for number in range(max(1, newest - most + 1), newest + 1):
        if sequences[number % slots] != number:
            continue
        oldest, kept = oldest or number, kept + 1
        try:
            kind, found = ring.decoded(number)
        except form.DamagedRingError:
            damaged += 1
            continue
        for part, record in enumerate(found):
            numbers.append(number)
            parts.append(part)
            times_ns.append(record.ns)
            kinds.append(_KINDS_OF_PARTS[part] if kind == form.CARRIED_OUT else kind)
    missing = newest - oldest + 1 - kept if kept else 0
    in_force = _in_force(data[: form.HEADER_BYTES])
    return Records(times_ns, kinds, lambda index: ring.record(numbers[index], parts[index]), in_force), damaged, missing


def _in_force(head: bytes) -> Calibration | None:
    """The calibration in a file's header; None: it states nothing, or what no gateway publishes."""
    try:
        content = decode(form.CALIBRATION, 0, header.calibration(head))
    except form.DamagedRingError:
        return None
    return content.calibration if isinstance(content, form.Calibrated) else None


class _Slots:
    """A file's slots, by sequence number."""

    def __init__(self, data: bytes, slots: int) -> None:
        self._data = data
        self._slots = slots

    def record(self, number: int, part: int) -> form.Record:
        """A record that has been decoded before, when it was found."""
        return self.decoded(number)[1][part]

    def decoded(self, number: int) -> tuple[int, list[form.Record]]:
        """A record's type and what it states, with what continues it: a record, or two, if it was CARRIED_OUT.

        None, where it is MORE, or a type of a later version. Raises DamagedError.
        """
        slot = last = self._slot(number)
        if slot.kind == form.MORE:
            return slot.kind, []
        rest = slot.rest
        while last.more:
            last = self._slot(last.sequence + 1)
            if last.kind != form.MORE or len(rest) > form.MAX_TEXT:
                raise form.DamagedRingError("a continued record is cut off")
            rest += last.rest
        content = decode(slot.kind, slot.ns, rest)
        if isinstance(content, form.CarriedOut):
            command = form.Record(number, slot.ns, content.command)
            return slot.kind, [command, form.Record(number, content.frame_ns, content.frame)]
        return slot.kind, [] if content is None else [form.Record(number, slot.ns, content)]

    def _slot(self, number: int) -> form.Slot:
        slot = form.read_slot(form.slot_bytes(self._data, number % self._slots))
        if slot is None or slot.sequence != number:
            raise form.DamagedRingError("a continued record is cut off")
        return slot
