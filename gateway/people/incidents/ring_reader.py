"""The records of a black box, and their reader.

Reads a ring that may be in use, cut off, damaged or another user's. It trusts what is in a whole record.

It copies the file, never more than `format.file_bytes(MAX_SLOTS)`: with a mapping, somebody who shortens the file
would end the reader with SIGBUS. It keeps the records' bytes, which takes four times the file's size on the computer of
a running gateway. All records as objects would take eight times.
"""

import math
import os
import stat
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

from pydantic import TypeAdapter
from pydantic_core import from_json

from gateway.errors import GatewayError
from gateway.host.file_lock import is_locked
from gateway.model import black_box as form
from gateway.model.black_box import MAX_SLOTS, copies_of
from gateway.model.elkapod import Measured, measured
from gateway.model.frames import ServoOp, read_op
from schemas.calibration import Calibration
from schemas.words import Cause

_MAX_BYTES: Final = form.file_bytes(MAX_SLOTS)
MOST_KEYFRAME: Final = 1_000_000
"""Bytes of a keyframe: fifty times what a moving robot's has."""


FORGED: Final = (ValueError, LookupError, ArithmeticError, TypeError, OSError, struct.error, zlib.error)
"""What reading a forged record raises. A record that this program wrote raises none of them."""

# ---- records

Outcomes = tuple[tuple[int, str], ...]
"""The requests that a step has ended: each number, and "accepted", "coalesced" or the reason of the rejection."""


class Start(NamedTuple):
    """A gateway starts. `wall_ns`: wall-clock time at this moment."""

    wall_ns: int
    facts: dict[str, Any]


class CommandRecord(NamedTuple):
    """A decoded command; the record's time is its arrival. `number`: that of its outcome; 0: its own outcome is here.

    Its step of the core came `after_ns` later (NO_STEP: a StepRecord has it, or there was none), `waited_ns`
    after its instant had begun. `lease`: the number of its token, 0: none.
    """

    number: int
    verb: str
    key: str
    source: str | None
    sent_ms: float | None
    targets: tuple[tuple[int, ServoOp], ...]
    source_id: str | None = None
    after_ns: int = form.NO_STEP
    waited_ns: int = 0
    lease: int = 0
    ended: Outcomes = ()


class StepRecord(NamedTuple):
    """An event of the core, as `robot.blackbox.journal` writes it; the record's time is that of its step."""

    instant_ns: int
    event: dict[str, Any]
    ended: Outcomes = ()


class Keyframe(NamedTuple):
    """The core's state between two steps, as `robot.blackbox.journal` writes it."""

    text: bytes


class Gap(NamedTuple):
    """From here to the next keyframe, events are missing: a source had used up its share."""


class FrameWritten(NamedTuple):
    """A written frame; the record's time is the end of its transfer. `late_ns`: after a watchdog's deadline."""

    data: bytes
    cause: str
    transfer_ns: int
    late_ns: int = 0


class EventPublished(NamedTuple):
    """A published event."""

    kind: str
    source: str | None
    key: str | None
    reason: str | None
    detail: str
    left_out: int


class Noted(NamedTuple):
    """What happened to the gateway itself; `what` is end, mode, lag, left_out or rejected, as in a Note."""

    what: str
    detail: str
    source: str | None = None
    key: str | None = None


class WallTime(NamedTuple):
    """Wall-clock time at this moment: once a second, and at the beginning of an incident."""

    wall_ns: int
    incident: str = ""
    """Its id, or ""."""


class About(NamedTuple):
    """Version and settings, recorded every five seconds, so that each incident's file has them."""

    facts: dict[str, Any]


Content = (
    Start
    | CommandRecord
    | StepRecord
    | Keyframe
    | Gap
    | FrameWritten
    | EventPublished
    | Noted
    | WallTime
    | About
    | Calibration
    | Measured
)
"""A Calibration is in force from then on. It is recorded every five seconds, and at each change."""


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
    """The records of a ring and its copies, in the order in which they were written. Each is decoded at its use."""

    def __init__(self, slots: Mapping[int, form.Slot], *, written: bool) -> None:
        """Take whole slots by sequence number. `written`: whether a gateway writes to the ring now."""
        self.written = written
        self.times_ns = array("q")
        self.kinds = bytearray()
        self.gaps: set[int] = set()
        """The places before which the ring has overwritten records that no copy has."""
        self._numbers = array("Q")
        self._rests: list[bytes] = []
        for number in sorted(slots):
            if len(self) and number - 1 not in slots:
                self.gaps.add(len(self))
            for kind, ns, rest in _contents(slots, number):
                self.kinds.append(kind)
                self.times_ns.append(ns)
                self._numbers.append(number)
                self._rests.append(rest)

    def __len__(self) -> int:
        return len(self.times_ns)

    def __getitem__(self, index: int) -> Record:
        return Record(self._numbers[index], self.times_ns[index], _content(self.kinds[index], self._rests[index]))

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
    data, written = _read_file(path, path)
    try:
        slots = _slots(data)
    except form.DamagedRingError as error:
        raise NoRingError(f"{path}: {error}") from error
    with suppress(OSError):
        for file in copies_of(path.resolve()):
            with suppress(NoRingError, form.DamagedRingError):  # cut off, or another user's
                slots |= _slots(_read_file(file, path)[0])
    return Records(slots, written=written)


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
            written = is_locked(opened.fileno()) is not False  # first: a gateway that ends meanwhile has written all
            return opened.read(found.st_size), written
    except OSError as error:
        raise NoRingError(f"{path}: {error.strerror}") from error


def _slots(data: bytes) -> dict[int, form.Slot]:
    """Return a file's whole slots by sequence number. Raises DamagedRingError."""
    count = form.slots_of(data[: form.HEADER_BYTES], len(data))
    slots = (form.read_slot(form.slot_bytes(data, index)) for index in range(count))
    return {slot.sequence: slot for slot in slots if slot is not None}


def _contents(slots: Mapping[int, form.Slot], number: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield type, time (ns) and content of what a record states: nothing if it is cut off, or continues another."""
    slot = last = slots[number]
    rest = slot.rest
    while last.more:
        more = slots.get(last.sequence + 1)
        if more is None or more.kind != form.MORE:
            return
        last = more
        rest += last.rest
    if slot.kind == form.CARRIED_OUT:
        content = BytesIO(rest)
        try:
            ns, transfer_ns, length, number, *of_command, own = _unpacked(form.CARRIED_OUT_HEAD, content)
        except struct.error:
            return
        data, frames = content.read(length), list[bytes]()
        while data:
            frames.append(data[: data[0] or length])
            data = data[len(frames[-1]) :]
        of_frames = b"".join([frame[2:] for frame in frames])
        targets = of_frames if own else content.read(len(of_frames))
        head = form.COMMAND_HEAD.pack(number, *of_command, len(targets) // form.TARGET_BYTES)
        yield form.COMMAND, slot.ns, head + targets + content.read() + form.outcomes(((number, form.ACCEPTED),))
        for frame in frames:
            yield form.FRAME, ns, form.frame(frame, Cause.COMMAND, transfer_ns)
    elif slot.kind in _READERS:
        yield slot.kind, slot.ns, rest


def _content(kind: int, rest: bytes) -> Content:
    """Return what a record states, or a note that nobody can read it: its checksum is right and its content is not."""
    try:
        return _READERS[kind](rest)
    except FORGED as error:
        return Noted("unreadable", f"{type(error).__name__} in a record of kind {kind}")


def _fields(kind: type[C]) -> Callable[[bytes], C]:
    """Return what reads a record of this content whose fields are JSON."""
    adapter = TypeAdapter(kind)
    return lambda rest: adapter.validate_python(from_json(rest, allow_inf_nan=False))


def _command(rest: bytes) -> CommandRecord:
    content = BytesIO(rest)
    number, sent_ms, after_ns, waited_ns, lease, count = _unpacked(form.COMMAND_HEAD, content)
    targets = tuple((_byte(content), read_op(content.read(form.TARGET_BYTES - 1), 0)) for _ in range(count))
    sent_ms = sent_ms if math.isfinite(sent_ms) else None
    verb, known = form.VERBS[_byte(content)], _byte(content)
    key = _text(content) if known == form.OTHER_KEY else form.KEYS[known]
    source, id_bytes = _text(content), _byte(content)
    source_id = (f"{int.from_bytes(content.read(id_bytes)):x}" if id_bytes else _text(content)) or None
    of_step = after_ns, waited_ns, lease, _outcomes(content)
    return CommandRecord(number, verb, key, source or source_id, sent_ms, targets, source_id, *of_step)


def _step(rest: bytes) -> StepRecord:
    content = BytesIO(rest)
    (instant_ns,), ended = _unpacked(form.STEP_HEAD, content), _outcomes(content)
    event = from_json(content.read())
    if not isinstance(event, dict):
        raise TypeError("an event is an object")
    return StepRecord(instant_ns, event, ended)


def _frame(rest: bytes) -> FrameWritten:
    content = BytesIO(rest)
    transfer_ns, late_ns, length = _unpacked(form.FRAME_HEAD, content)
    return FrameWritten(content.read(length), _text(content), transfer_ns, late_ns)


def _unpacked(head: struct.Struct, content: BytesIO) -> tuple[Any, ...]:
    """Read a structure. It and the functions below raise an exception of FORGED where the content ends too early."""
    return head.unpack(content.read(head.size))


def _byte(content: BytesIO) -> int:
    return content.read(1)[0]


def _text(content: BytesIO) -> str:
    return content.read(_byte(content)).decode()


def _outcomes(content: BytesIO) -> Outcomes:
    return tuple((*_unpacked(form.OUTCOME_HEAD, content), _text(content)) for _ in range(_byte(content)))


_READERS: Final[dict[int, Callable[[bytes], Content]]] = {
    form.COMMAND: _command,
    form.STEP: _step,
    form.KEYFRAME: lambda rest: Keyframe(zlib.decompressobj().decompress(rest, MOST_KEYFRAME)),
    form.GAP: lambda _: Gap(),
    form.FRAME: _frame,
    form.CALIBRATION: Calibration.model_validate_json,
    form.MEASURED: measured,
    form.START: _fields(Start),
    form.EVENT: _fields(EventPublished),
    form.ABOUT: _fields(About),
    **dict.fromkeys((form.NOTE, form.END), _fields(Noted)),
    **dict.fromkeys((form.CLOCK, form.INCIDENT), _fields(WallTime)),
}
