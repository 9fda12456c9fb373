"""The records of a black box, and their reader.

Reads a ring that may be in use, cut off, damaged or another user's. It trusts what is in a whole record.

It holds a copy of the file, never more than `format.file_bytes(MAX_SLOTS)`: with a mapping, somebody who shortens the
file would end the reader with SIGBUS. It also holds about 26 bytes for each record. All records as objects would take
eight times the file's size, on the computer of a running gateway (docs/recordings.md).
"""

import math
import os
import stat
import struct
from array import array
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from pydantic import TypeAdapter
from pydantic_core import from_json

from gateway.errors import GatewayError
from gateway.host.file_lock import is_locked
from gateway.model.black_box import format as form
from gateway.model.black_box.format import MAX_SLOTS, copies_of
from gateway.model.elkapod import Measured, measured
from gateway.model.frames import MAX_ANGLE_CDEG, Op, ServoOp
from schemas.calibration import Calibration
from schemas.telemetry import Cause

_MAX_BYTES: Final = form.file_bytes(MAX_SLOTS)


# ---- records


class Start(NamedTuple):
    """A gateway starts. `wall_ns`: wall-clock time at this moment."""

    wall_ns: int
    facts: dict[str, Any]


class CommandRecord(NamedTuple):
    """A decoded command; the record's time is its arrival. A Decision with its number follows (0: none does)."""

    number: int
    verb: str
    key: str
    source: str | None
    sent_ms: float | None
    targets: tuple[tuple[int, ServoOp], ...]


class Decision(NamedTuple):
    """The outcome of a command: "accepted", "coalesced", or the reason of its rejection."""

    number: int
    verdict: str
    key: str
    source: str | None


class FrameWritten(NamedTuple):
    """A written frame; the record's time is the end of its transfer. `late_ns`: a watchdog's Stop after its deadline.

    `number`: the command accepted with it, which then has no Decision; 0: none.
    """

    data: bytes
    cause: str
    transfer_ns: int
    late_ns: int = 0
    number: int = 0


class EventPublished(NamedTuple):
    """A published event."""

    kind: str
    source: str | None
    key: str | None
    reason: str | None
    detail: str
    left_out: int


class Noted(NamedTuple):
    """What happened to the gateway itself; `what` is end, mode, lag or left_out, as in a Note."""

    what: str
    detail: str
    source: str | None = None


class WallTime(NamedTuple):
    """Wall-clock time at this moment: once a second, and at the beginning of an incident."""

    wall_ns: int
    incident: str = ""
    """Its id, or ""."""


class About(NamedTuple):
    """Version and settings, recorded every five seconds, so that each incident's file has them."""

    facts: dict[str, Any]


Content = (
    Start | CommandRecord | Decision | FrameWritten | EventPublished | Noted | WallTime | About | Calibration | Measured
)
"""A Calibration is in force from then on. It is recorded every five seconds; before a change, the former one, too."""


class Record(NamedTuple):
    """One record; `ns` is of the monotonic clock."""

    sequence: int
    ns: int
    content: Content


# ---- reading

C = TypeVar("C", bound=Content)


class NoRingError(GatewayError):
    """The black box cannot be read."""


class Records:
    """Decodable records of several files, in the order in which they were written. Each is decoded again at its use."""

    def __init__(self) -> None:
        self.times_ns = array("q")
        self.kinds = bytearray()
        self.gaps: set[int] = set()
        """The places before which the ring has overwritten records that no copy has."""
        self.newest = 0
        """Sequence number of the newest record taken."""
        self.written = False
        """Whether a gateway writes to the ring now."""
        self._files: list[_Slots] = []
        self._places = array("B")  # in `_files`
        self._numbers = array("Q")

    def take(self, file: "_Slots", numbers: Iterable[int]) -> None:
        """Add those of these records of a file that can be decoded."""
        self._files.append(file)
        for place, number in enumerate(numbers):
            if not place and self.newest and number > self.newest + 1:
                self.gaps.add(len(self))
            self.newest = number
            with suppress(form.DamagedRingError):
                for kind, record in file.decoded(number).items():
                    self._places.append(len(self._files) - 1)
                    self._numbers.append(number)
                    self.times_ns.append(record.ns)
                    self.kinds.append(kind)

    def __len__(self) -> int:
        return len(self.times_ns)

    def __getitem__(self, index: int) -> Record:
        return self._files[self._places[index]].decoded(self._numbers[index])[self.kinds[index]]

    def __iter__(self) -> Iterator[Record]:
        return map(self.__getitem__, range(len(self)))

    def calibration_at(self, ns: int) -> Calibration | None:
        """Return the calibration in force at `ns`; None: unknown."""
        content = self._latest(form.CALIBRATION, ns)
        return content if isinstance(content, Calibration) else None

    def about_at(self, ns: int) -> dict[str, Any]:
        """Return versions and settings of the gateway that ran at `ns`; empty if unknown."""
        content = self._latest(form.ABOUT, ns)
        return content.facts if isinstance(content, About) else {}

    def _latest(self, kind: int, ns: int) -> Content | None:
        """Return the content of the latest record of this type at `ns`, else of the first; None: there is none."""
        places = [index for index, each in enumerate(self.kinds) if each == kind]
        found = [index for index in places if self.times_ns[index] <= ns][-1:] or places[:1]
        return self[found[0]].content if found else None


def read(path: Path) -> Records:
    """Return all whole records of a ring and its copies. Raises NoRingError if `path` is no readable ring."""
    found = Records()
    data, found.written = _read_file(path, path)
    try:
        ring = _Slots(data)
    except form.DamagedRingError as error:
        raise NoRingError(f"{path}: {error}") from error
    with suppress(OSError):
        for file in copies_of(path.resolve()):  # oldest first; of each its records that are older than all of the ring
            with suppress(NoRingError, form.DamagedRingError):  # cut off, or another user's
                copy = _Slots(_read_file(file, path)[0])
                found.take(copy, copy.numbers(found.newest + 1, ring.oldest))
    found.take(ring, ring.numbers(ring.oldest, ring.newest + 1))
    return found


def _read_file(file: Path, path: Path) -> tuple[bytes, bool]:
    """Return a file's bytes, and whether a gateway writes to it. `path`: the ring, or its link. Raises NoRingError."""
    try:
        with open(file, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as opened:
            found = os.fstat(opened.fileno())
            if not stat.S_ISREG(found.st_mode) or found.st_size > _MAX_BYTES:
                raise NoRingError(f"{path}: it is no black box")
            # In /dev/shm anybody may put a file where our link leads.
            trusted = (path.lstat().st_uid, os.geteuid(), 0)
            if found.st_uid not in trusted or found.st_nlink != 1 or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                raise NoRingError(f"{path}: another user has made this file, or may write to it; it is not read")
            written = is_locked(opened.fileno())  # first: a gateway that ends meanwhile has written all
            return opened.read(found.st_size), written
    except OSError as error:
        raise NoRingError(f"{path}: {error.strerror}") from error


class _Slots:
    """A file's slots, by sequence number."""

    def __init__(self, data: bytes) -> None:
        """Raises DamagedRingError."""
        self._data = data
        self._slots = slots = form.slots_of(data[: form.HEADER_BYTES], len(data))
        self._sequences = array("Q", bytes(slots * 8))  # of each slot's record; 0: it has none
        for index in range(slots):
            slot = form.read_slot(form.slot_bytes(data, index))
            if slot is not None and slot.sequence % slots == index:
                self._sequences[index] = slot.sequence
        self.newest = max(self._sequences)
        # Records more than a round old are partly overwritten, so a leftover slot does not count.
        self.oldest = next(self.numbers(max(1, self.newest - slots + 1), self.newest + 1), 0)

    def numbers(self, begin: int, end: int) -> Iterator[int]:
        """Return the sequence numbers of whole records from `begin` to before `end`, in order."""
        slots, sequences = self._slots, self._sequences
        begin, end = max(begin, self.newest - slots + 1, 1), min(end, self.newest + 1)
        return (number for number in range(begin, end) if sequences[number % slots] == number)

    def decoded(self, number: int) -> dict[int, Record]:
        """Return what a record states, with what continues it (itself MORE, which states nothing); see `decode`."""
        slot = last = self._slot(number)
        if slot.kind == form.MORE:
            return {}
        rest = slot.rest
        while last.more:
            last = self._slot(last.sequence + 1)
            if last.kind != form.MORE or len(rest) > form.MAX_BYTES:
                raise form.DamagedRingError("a continued record is cut off")
            rest += last.rest
        return decode(slot.kind, number, slot.ns, rest)

    def _slot(self, number: int) -> form.Slot:
        slot = form.read_slot(form.slot_bytes(self._data, number % self._slots))
        if slot is None or slot.sequence != number:
            raise form.DamagedRingError("a continued record is cut off")
        return slot


def decode(kind: int, number: int, ns: int, rest: bytes) -> dict[int, Record]:
    """Return what a record states, by type: nothing of a later version's, two records if it was CARRIED_OUT.

    Raises form.DamagedRingError if `rest` is damaged.
    """
    try:
        if kind == form.CARRIED_OUT:
            command, frame, after_ns = _carried_out(rest)
            return {form.COMMAND: Record(number, ns, command), form.FRAME: Record(number, ns + after_ns, frame)}
        reader = _READERS.get(kind)
        return {} if reader is None else {kind: Record(number, ns, reader(rest))}
    except (struct.error, ValueError, IndexError, RecursionError) as error:
        raise form.DamagedRingError(str(error)) from error


def _fields(kind: type[C]) -> Callable[[bytes], C]:
    """Return what reads a record of this content whose fields are JSON."""
    adapter = TypeAdapter(kind)
    return lambda rest: adapter.validate_python(from_json(rest, allow_inf_nan=False))


def _command(rest: bytes) -> CommandRecord:
    number, sent_ms, count = form.COMMAND_HEAD.unpack_from(rest)
    flat = form.TARGET_STRUCTS[count].unpack_from(rest, form.COMMAND_HEAD.size)
    targets = tuple((flat[index], _op(flat[index + 1])) for index in range(0, len(flat), 2))
    verb, key, source = _read_texts(rest, form.COMMAND_HEAD.size + form.TARGET_STRUCTS[count].size, 3)
    return CommandRecord(number, verb, key, source or None, sent_ms if math.isfinite(sent_ms) else None, targets)


def _decision(rest: bytes) -> Decision:
    verdict, key, source = _read_texts(rest, form.DECISION_HEAD.size, 3)
    return Decision(form.DECISION_HEAD.unpack_from(rest)[0], verdict, key, source or None)


def _frame(rest: bytes) -> FrameWritten:
    transfer_ns, late_ns, number, length = form.FRAME_HEAD.unpack_from(rest)
    (cause,) = _read_texts(rest, form.FRAME_HEAD.size + length, 1)
    return FrameWritten(rest[form.FRAME_HEAD.size : form.FRAME_HEAD.size + length], cause, transfer_ns, late_ns, number)


def _carried_out(rest: bytes) -> tuple[CommandRecord, FrameWritten, int]:
    """Return a command, the frame that it was accepted with, and the ns from its arrival to the transfer's end."""
    after_ns, transfer_ns, length, data = form.CARRIED_OUT_HEAD.unpack_from(rest)
    command = _command(rest[form.CARRIED_OUT_HEAD.size :])
    return command, FrameWritten(data[:length], Cause.COMMAND, transfer_ns, 0, command.number), after_ns


def _op(value: int) -> ServoOp:
    """Raises FrameError, a ValueError, if it is no operation."""
    if value == form.STOP_CODE:
        return ServoOp(Op.STOP)
    if value <= MAX_ANGLE_CDEG:
        return ServoOp(Op.START, value)
    return ServoOp(Op.SET, value - form.SET_CODE)


def _read_texts(rest: bytes, begin: int, count: int) -> list[str]:
    texts = []
    for _ in range(count):
        end = begin + 1 + rest[begin]
        texts.append(rest[begin + 1 : end].decode())
        begin = end
    return texts


_READERS: Final[dict[int, Callable[[bytes], Content]]] = {
    form.COMMAND: _command,
    form.DECISION: _decision,
    form.FRAME: _frame,
    form.CALIBRATION: Calibration.model_validate_json,
    form.MEASURED: measured,
    form.START: _fields(Start),
    form.EVENT: _fields(EventPublished),
    form.ABOUT: _fields(About),
    **dict.fromkeys((form.NOTE, form.END), _fields(Noted)),
    **dict.fromkeys((form.CLOCK, form.INCIDENT), _fields(WallTime)),
}
