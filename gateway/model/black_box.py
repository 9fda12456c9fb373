"""The black box's files and incidents. `people.incidents.ring_reader` has what a record contains.

A file begins with a page that has magic, version, the size of a slot, and how many there are (`new_header`). Slots of
SLOT bytes follow. The record with sequence number n is in slot n modulo the number of slots:

| bytes  | content                                                                                        |
|--------|------------------------------------------------------------------------------------------------|
| 0-3    | CRC-32 of the next `length` bytes                                                              |
| 4-5    | length: of all that follows the checksum                                                       |
| 6      | type                                                                                           |
| 7      | 1: the next record (type MORE) continues this one, which did not fit                           |
| 8-15   | sequence number, from 1                                                                        |
| 16-23  | when, ns of the monotonic clock                                                                |
| 24-127 | by type, padded with zeros                                                                     |

A process that is killed while it writes leaves a slot with a wrong checksum. Numbers are little-endian.

Commands and frames are packed by hand, since a gait writes many: a frame takes 0.3 µs, by a declarative
table 3.5 µs, by `construct` 20.9 µs (10.2 compiled). Their texts are UTF-8, preceded by their length, so that a new
reason or cause needs no new version. A command key has a number, so a new key needs one. Measurements are as the
controller sends them; other records are JSON.
"""

import json
import re
import struct
import zlib
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from gateway.model.frames import ServoOp, bytes_of
from schemas.keys import COMMAND_KEYS
from schemas.words import Kind

HEADER_BYTES: Final = 4096
"""One page, so that slots begin on a page boundary."""
SLOT: Final = 128
"""Room for a command of one leg with a source of 60 characters. One of all legs with a long name takes two slots."""
ROOM: Final = SLOT - 24
MAX_TEXT: Final = 1000
"""Characters of a text in JSON; the longest sentence of an event has about 400."""

_HEAD: Final = struct.Struct("<HBBQq")
_SLOT: Final = struct.Struct(f"<I{SLOT - 4}s")
_CHECKED_HEAD: Final = struct.Struct("<IHBBQq")
HEAD_BYTES: Final = _HEAD.size
pack_head: Final = _HEAD.pack
pack_slot_into: Final = _SLOT.pack_into
"""Pack a head; pack checksum and body into a slot."""

# ---- types

START, END, COMMAND, FRAME, NOTE, EVENT, INCIDENT, MORE, CLOCK, CARRIED_OUT, CALIBRATION, ABOUT = range(1, 13)
MEASURED: Final = 13
STEP, KEYFRAME, GAP = range(14, 17)
"""The journal, with commands: an event of the core that is no such command, its state, and the lack of an event."""


ACCEPTED: Final = "accepted"
COALESCED: Final = "coalesced"
"""Verdicts on a request, next to the reasons of rejections."""

SETTINGS: Final = ("spi", "watchdog", "limits", "lease", "buttons", "safety", "power")
"""The sections of the settings that are recorded, from which the core's rules follow; of the wire, only its name is."""
STOP_FACTS: Final = ("stop_servos_first_ns", "stop_servos_last_ns")
"""Facts of a start: the times of `gateway.robot.spi.stop_all.take_note`, if `stop-servos` ran before it."""


class DamagedRingError(ValueError):
    """The bytes are not a record of this format."""


# ---- a slot


class Slot(NamedTuple):
    """A slot with a valid checksum."""

    kind: int
    more: bool
    sequence: int
    ns: int
    rest: bytes


def slot_bytes(data: bytes, index: int) -> bytes:
    """Return the bytes of slot `index` of a file."""
    begin = HEADER_BYTES + index * SLOT
    return data[begin : begin + SLOT]


def read_slot(data: bytes) -> Slot | None:
    """Decode a slot of SLOT bytes. Return None if it holds no valid record."""
    checksum, length, kind, more, sequence, ns = _CHECKED_HEAD.unpack_from(data)
    if not _HEAD.size <= length <= SLOT - 4 or zlib.crc32(data[4 : 4 + length]) != checksum:
        return None
    return Slot(kind, bool(more), sequence, ns, data[4 + _HEAD.size : 4 + length])


def newest(buffer: Any, slots: int) -> int:
    """Return the highest sequence number of a valid record; 0: there is none."""
    with memoryview(buffer) as whole, whole[HEADER_BYTES:].cast("Q") as words:
        numbers = words[1 :: SLOT // 8].tolist()  # a slot's second word
    in_place = (number for slot, number in enumerate(numbers) if number and number % slots == slot)
    for number in sorted(in_place, reverse=True):
        if read_slot(slot_bytes(buffer, number % slots)) is not None:
            return int(number)
    return 0


# ---- content, by type: structures, and functions that return the bytes of a record's content

COMMAND_HEAD: Final = struct.Struct("<IdIIIB")
"""A command's number and `sent_ms`; then of its step, in ns, the time since its arrival (NO_STEP: none) and since the
instant began; the lease's number (0: no token); how many targets follow. Then come the sender and the outcomes."""
STEP_HEAD: Final = struct.Struct("<q")
"""When the step's instant began; the outcomes follow, then the event as JSON."""
OUTCOME_HEAD: Final = struct.Struct("<I")
FRAME_HEAD: Final = struct.Struct("<IIB")
CARRIED_OUT_HEAD: Final = struct.Struct("<qIBIdIII?")
"""When the transfer of a command's frames ended, its duration (both in ns), and the length of the frames; then as in
COMMAND_HEAD, but in place of the number of targets, whether the frames have them. The frames follow, then any other
targets, as many, then the sender."""
TARGET_BYTES: Final = 4
"""A target is as in a frame: SERVO ID, OP, INT, FLOAT."""
NO_STEP: Final = 0xFFFFFFFF
_UINT32: Final = NO_STEP
SENT_NOT: Final = float("nan")
_MAX_BYTE: Final = 255


@lru_cache(200)  # texts recur
def _texts(*texts: str | None) -> bytes:
    """Return texts of at most 255 bytes, each after its length; None becomes ""."""
    made = b""
    for text in texts:
        data = text.encode("utf-8", "replace") if text else b""
        if len(data) > _MAX_BYTE:
            data = data[:_MAX_BYTE].decode("utf-8", "ignore").encode()
        made += bytes((len(data),)) + data
    return made


VERBS: Final = ("put", "delete", "get", "lost")
KEYS: Final = tuple(COMMAND_KEYS)
OTHER_KEY: Final = len(KEYS)
ID_BYTES: Final = 16


@lru_cache(200)
def sender(verb: str, key: str, source: str | None, source_id: str | None) -> bytes:
    """Return a command's verb, key and sender: texts as in `_texts`, and a Zenoh id as 16 bytes.

    A `source` that is the id is stored as "".
    """
    known = KEYS.index(key) if key in COMMAND_KEYS else OTHER_KEY
    texts = _texts(*(key,) * (known == OTHER_KEY), None if source == source_id else source)
    try:
        number = int(source_id or "", 16)
        sender = bytes((ID_BYTES,)) + number.to_bytes(ID_BYTES, "big")
        sender = sender if f"{number:x}" == source_id else b""
    except (ValueError, OverflowError):
        sender = b""
    return bytes((VERBS.index(verb), known)) + texts + (sender or b"\0" + _texts(source_id))


def outcomes(ended: Sequence[tuple[int, str]]) -> bytes:
    """Bytes of the requests that a step has ended: the lower 32 bits of each number, and its verdict."""
    each = [OUTCOME_HEAD.pack(number & _UINT32) + _texts(verdict) for number, verdict in ended[:_MAX_BYTE]]
    return bytes((len(each),)) + b"".join(each)


def command(
    number: int,
    verb: str,
    key: str,
    source: str | None,
    sent_ms: float | None,
    targets: Sequence[tuple[int, ServoOp]],
    source_id: str | None = None,
    after_ns: int = NO_STEP,
    waited_ns: int = 0,
    lease: int = 0,
    ended: Sequence[tuple[int, str]] = (),
) -> bytes:
    """Bytes of a CommandRecord; `sent_ms` None is stored as NaN."""
    sent_ms = SENT_NOT if sent_ms is None else sent_ms
    fixed = COMMAND_HEAD.pack(number & _UINT32, sent_ms, after_ns, waited_ns, lease, len(targets))
    return fixed + bytes_of(targets) + sender(verb, key, source, source_id) + outcomes(ended)


def step(instant_ns: int, event: bytes, ended: Sequence[tuple[int, str]] = ()) -> bytes:
    """Bytes of a StepRecord; `event` is JSON."""
    return STEP_HEAD.pack(instant_ns) + outcomes(ended) + event


def frame(data: bytes, cause: str, transfer_ns: int, late_ns: int = 0) -> bytes:
    """Bytes of a FrameWritten, with the lower 32 bits of each number."""
    return FRAME_HEAD.pack(transfer_ns & _UINT32, late_ns & _UINT32, len(data)) + data + _texts(cause)


def fields(*values: object) -> bytes:
    """Bytes of a record that is rare: its fields as JSON, with texts cut at MAX_TEXT."""
    cut = [value[:MAX_TEXT] if isinstance(value, str) else value for value in values]
    return json.dumps(cut, ensure_ascii=False).encode("utf-8", "replace")


# ---- the header

VERSION: Final = 5
MAGIC: Final = b"hexapod black box\n"


def new_header(slots: int) -> bytes:
    """Return the header of a new file."""
    return struct.pack("<18sHII", MAGIC, VERSION, SLOT, slots).ljust(HEADER_BYTES, b"\0")


def file_bytes(slots: int) -> int:
    """Return the size of a file in bytes, header included."""
    return HEADER_BYTES + slots * SLOT


def slots_of(head: bytes, size: int) -> int:
    """Return how many slots a file of `size` bytes with this head has. Raises DamagedRingError if it is no ring."""
    if not size:
        raise DamagedRingError("it is empty: its gateway had no room for it, as its log states")
    slots = max(0, size - HEADER_BYTES) // SLOT
    if not slots or size != file_bytes(slots) or head != new_header(slots):
        raise DamagedRingError("it is no black box of this version")
    return slots


# ---- the files

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


# ---- incidents

FOLLOW_NS: Final = 5_000_000_000
"""An incident includes the 5 s after its latest event."""
LONGEST_INCIDENT_NS: Final = 30_000_000_000
"""Later events prolong an incident up to this."""
LANDING_NS: Final = 5_000_000_000
"""The highest `watchdog.landing_ms`: the Stops at a landing's end belong to its incident."""

INCIDENT_NAMES: Final = {
    Kind.WATCHDOG_EXPIRED: "watchdog",
    Kind.LANDING: "landing",
    Kind.ESTOP_ENGAGED: "estop",
    Kind.BUS_FAULT: "bus-fault",
    Kind.CONTROLLER_SILENT: "controller-silent",
    Kind.CONTROLLER_RESTARTED: "controller-restarted",
    Kind.FALLEN: "fallen",
    Kind.OVERFLOW: "overflow",
    Kind.LEASE_TAKEN: "lease-taken",
    Kind.STOPPED_OUTSIDE: "stopped-outside",
    Kind.BUTTON_SILENT: "button",
    Kind.BUTTON_LEFT: "button",
    Kind.POWER_UNCONFIRMED: "power-unconfirmed",
    Kind.POWER_FAULT: "power-fault",
    Kind.SERVO_DRAWS: "servo-draws",
    Kind.OFF_BUTTON: "off-button",
}
"""Events that are kept as incidents, and the ends of their ids."""
MISTAKE: Final = "mistake"
"""An unexpected exception has ended the service."""


def follow_ns(what: str) -> int:
    """Return how long (ns) later events belong to an incident: `what` is the end of its id, or a later event's kind."""
    return FOLLOW_NS + LANDING_NS if what == Kind.LANDING else FOLLOW_NS


def incident_id(wall_ns: int, what: str) -> str:
    """Return an id such as 20261122-001233-123-watchdog: the time in UTC to the millisecond, and `what` happened."""
    seconds, ns = divmod(wall_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y%m%d-%H%M%S}-{ns // 1_000_000:03d}-{what}"
