"""The black box's records: what is in them, where each byte is, and how they are written.

The readers are in `people/incidents/ring_decoding.py`.

A file is a header and slots of SLOT bytes. The record with sequence number n is in slot n modulo the number of slots:

| bytes  | what                                                                                           |
|--------|------------------------------------------------------------------------------------------------|
| 0-3    | CRC-32 of the next `length` bytes                                                              |
| 4-5    | length: of all that follows the checksum                                                       |
| 6      | type                                                                                           |
| 7      | 1: the next record (type MORE) continues this one, which did not fit                           |
| 8-15   | sequence number, from 1                                                                        |
| 16-23  | when, ns of the monotonic clock                                                                |
| 24-127 | what the type says, padded with zeros                                                          |

A process that is killed while it writes leaves a slot whose checksum is wrong. Numbers are little-endian. Texts are
UTF-8, preceded by their length, so that a kind, reason or cause that is added later needs no new version.

Records are packed by hand, since they are written beside a gait: of a frame 0.3 µs, by a declarative table 3.5 µs, by
`construct` 20.9 µs (10.2 compiled), measured in one run.
"""

import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from gateway.robot.protocol.frames import ServoOp

from schemas.calibration import Calibration
from schemas.robot import JOINTS

HEADER_BYTES: Final = 4096
"""A page of its own, so that slots begin on a page; `header` says what is in it."""
SLOT: Final = 128
"""Room for a command of one leg with a source of 60 characters; one of all legs with a long name takes two slots."""
ROOM: Final = SLOT - 24
MAX_NS: Final = 2**62
"""Later than any time of a record: the year 2116, or a machine that runs for 146 years."""
MAX_SEQUENCE: Final = 2**63
"""A gateway that continues a ring goes on from its newest record: it never runs out of numbers."""
MAX_TEXT: Final = 4000
"""Bytes of a record's continued content: the longest sentence of an event has some 400."""

_HEAD: Final = struct.Struct("<HBBQq")
_SLOT: Final = struct.Struct(f"<I{SLOT - 4}s")
_CRC: Final = struct.Struct("<I")
_SEQUENCE_BYTES: Final = 8
"""Of a sequence number, and where it begins in its slot."""
HEAD_BYTES: Final = _HEAD.size
pack_head: Final = _HEAD.pack
pack_slot_into: Final = _SLOT.pack_into
"""The two halves of `put`: a head before a record's content, and both with their checksum into a slot."""

# ---- types

START, END, COMMAND, DECISION, FRAME, MODE, EVENT, LAG, INCIDENT, MORE, CLOCK, CARRIED_OUT, CALIBRATION = range(1, 14)
ABOUT: Final = 14


STOP_FACTS: Final = ("stop_servos_first_ns", "stop_servos_last_ns")
"""Among the facts of a start: when `stop-servos` wrote before it, as in `gateway.robot.host.stop_note`."""


@dataclass(frozen=True, slots=True)
class Start:
    """A gateway starts. `wall_ns` is the time that people read at this moment."""

    wall_ns: int
    facts: dict[str, Any]


@dataclass(frozen=True, slots=True)
class End:
    """A gateway ends in order, after its last Stops."""

    why: str


@dataclass(frozen=True, slots=True)
class CommandRecord:
    """A command as decoded; the record's time is its arrival. A Decision with its number follows (0: it has none)."""

    number: int
    verb: str
    key: str
    source: str | None
    sent_ms: float | None
    targets: tuple[tuple[int, ServoOp], ...]


@dataclass(frozen=True, slots=True)
class Decision:
    """What became of a command: "accepted", "coalesced", or the reason of its rejection."""

    number: int
    verdict: str
    key: str
    source: str | None


@dataclass(frozen=True, slots=True)
class FrameWritten:
    """A frame on the wire; the record's time is when its transfer had ended. `late_ns`: of a watchdog's, how late.

    `number`: the command that was accepted with it, which then needs no Decision; 0: none.
    """

    data: bytes
    cause: str
    transfer_ns: int
    late_ns: int = 0
    number: int = 0


@dataclass(frozen=True, slots=True)
class CarriedOut:
    """A command and the frame that it was accepted with, whose transfer had ended at `frame_ns`, in one record.

    Its time is the command's arrival. Readers are given it as two records, the command's and the frame's.
    """

    command: CommandRecord
    frame: FrameWritten
    frame_ns: int


@dataclass(frozen=True, slots=True)
class ModeChange:
    """The gateway's mode from now on."""

    mode: str


@dataclass(frozen=True, slots=True)
class EventTold:
    """An event as it was published."""

    kind: str
    source: str | None
    key: str | None
    reason: str | None
    detail: str
    left_out: int


@dataclass(frozen=True, slots=True)
class Lag:
    """The loop's timer ran late."""

    lag_ns: int


@dataclass(frozen=True, slots=True)
class Clock:
    """The time that people read at this moment, once a second."""

    wall_ns: int


@dataclass(frozen=True, slots=True)
class IncidentBegun:
    """Something happened that is to be kept. `wall_ns` is the time that people read at this moment."""

    wall_ns: int
    incident: str


@dataclass(frozen=True, slots=True)
class Calibrated:
    """What is in force from now on; where it changes, what was in force until now is recorded before it."""

    calibration: Calibration


@dataclass(frozen=True, slots=True)
class About:
    """Which version runs, and by which settings, every ten seconds: so each incident's file can have them."""

    facts: dict[str, Any]


Content = (
    Start
    | End
    | CommandRecord
    | Decision
    | FrameWritten
    | ModeChange
    | EventTold
    | Lag
    | Clock
    | IncidentBegun
    | Calibrated
    | About
)


@dataclass(frozen=True, slots=True)
class Record:
    """One record: its sequence number, when (ns of the monotonic clock), and what."""

    sequence: int
    ns: int
    content: Content


class DamagedError(ValueError):
    """Bytes that are no record of this format."""


# ---- a slot


def put(buffer: Any, offset: int, kind: int, sequence: int, ns: int, rest: bytes, more: bool = False) -> None:
    """Write one slot; `rest` has at most ROOM bytes."""
    body = pack_head(len(rest) + HEAD_BYTES, kind, more, sequence, ns) + rest
    pack_slot_into(buffer, offset, zlib.crc32(body), body)


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot with a good checksum."""

    kind: int
    more: bool
    sequence: int
    ns: int
    rest: bytes


def slot_bytes(data: bytes, index: int) -> bytes:
    """A slot of a file, by its place in it."""
    begin = HEADER_BYTES + index * SLOT
    return data[begin : begin + SLOT]


def read_slot(data: bytes) -> Slot | None:
    """What a slot of SLOT bytes holds; None: no whole record."""
    (checksum,) = _CRC.unpack_from(data)
    length, kind, more, sequence, ns = _HEAD.unpack_from(data, _CRC.size)
    if (
        not 0 <= ns < MAX_NS
        or not 0 < sequence < MAX_SEQUENCE
        or not _HEAD.size <= length <= SLOT - _CRC.size
        or zlib.crc32(data[4 : 4 + length]) != checksum
    ):
        return None
    return Slot(kind, bool(more), sequence, ns, data[4 + _HEAD.size : 4 + length])


def newest(buffer: Any, slots: int) -> tuple[int, int]:
    """The highest sequence number of a whole record in a file (0: none), and how many above it are not whole."""
    with memoryview(buffer) as whole, whole[HEADER_BYTES:].cast("Q") as words:
        numbers = words[1 :: SLOT // _SEQUENCE_BYTES].tolist()
    in_place = [number for slot, number in enumerate(numbers) if number and number % slots == slot]
    for torn, number in enumerate(sorted(in_place, reverse=True)):
        offset = HEADER_BYTES + number % slots * SLOT
        if read_slot(buffer[offset : offset + SLOT]) is not None:
            return int(number), torn
    return 0, len(in_place)


# ---- what the types say

WALL: Final = struct.Struct("<q")
COMMAND_HEAD: Final = struct.Struct("<IdB")
DECISION_HEAD: Final = struct.Struct("<I")
FRAME_HEAD: Final = struct.Struct("<IIIB")
_MOST_FRAME: Final = 14
"""Bytes of a frame in a CarriedOut; a longer one is a record of its own, since evidence is never cut."""
CARRIED_OUT_HEAD: Final = struct.Struct(f"<IIB{_MOST_FRAME}s")
"""Of a CarriedOut: from the arrival to the end of the frame's transfer, and how long that took, in ns; the frame's
length, and the frame. The command follows, as in a record of its own."""
_UINT32: Final = 0xFFFFFFFF
EVENT_HEAD: Final = struct.Struct("<I")
TARGETS: Final = tuple(struct.Struct("<" + "BH" * count) for count in range(19))
_SENT_NOT: Final = float("nan")
_OF_A_LEG: Final = len(JOINTS)

STOP_CODE, SET_CODE = 65_535, 20_000
_OF_OP: Final = (0, 0, STOP_CODE, SET_CODE)
"""By the operation's code. Operation and angle (0 to 18000) are one number of 16 bits."""
MAX_ANGLE_CDEG: Final = 18_000
_MAX_BYTE: Final = 255


_known: dict[tuple[str | None, ...], bytes] = {}
MAX_KNOWN: Final = 200


def _texts(*texts: str | None) -> bytes:
    """Texts of at most 255 bytes, each behind its length; None is written as an empty one. The same come again."""
    made = _known.get(texts)
    if made is None:
        if len(_known) >= MAX_KNOWN:
            _known.clear()
        made = _known[texts] = _encoded(texts)
    return made


def _encoded(texts: Sequence[str | None]) -> bytes:
    made = b""
    for text in texts:
        data = text.encode("utf-8", "replace") if text else b""
        if len(data) > _MAX_BYTE:
            data = data[:_MAX_BYTE].decode("utf-8", "ignore").encode()
        made += bytes((len(data),)) + data
    return made


def start(wall_ns: int, facts: dict[str, Any]) -> bytes:
    """Of a Start."""
    return WALL.pack(wall_ns) + json.dumps(facts).encode()


def command(
    number: int,
    verb: str,
    key: str,
    source: str | None,
    sent_ms: float | None,
    targets: Sequence[tuple[int, ServoOp]],
) -> bytes:
    """Of a CommandRecord."""
    flat: list[int] = []
    for servo_id, op in targets:
        flat += (servo_id, _OF_OP[op.op] + op.angle_cdeg)
    count = len(targets)
    fixed = COMMAND_HEAD.pack(number & _UINT32, _SENT_NOT if sent_ms is None else sent_ms, count)
    texts = _known.get((verb, key, source)) or _texts(verb, key, source)
    return fixed + TARGETS[count].pack(*flat) + texts


def decision(number: int, verdict: str, key: str, source: str | None) -> bytes:
    """Of a Decision."""
    return DECISION_HEAD.pack(number & _UINT32) + _texts(verdict, key, source)


def frame(data: bytes, cause: str, transfer_ns: int, late_ns: int = 0, number: int = 0) -> bytes:
    """Of a FrameWritten."""
    return (
        FRAME_HEAD.pack(transfer_ns & _UINT32, late_ns & _UINT32, number & _UINT32, len(data))
        + data
        + (_known.get((cause,)) or _texts(cause))
    )


_CARRIED_OUT: Final = struct.Struct(f"<{_HEAD.format[1:]}{CARRIED_OUT_HEAD.format[1:]}{COMMAND_HEAD.format[1:]}BHBHBH")
_CARRIED_OUT_HEAD_BYTES: Final = _CARRIED_OUT.size - HEAD_BYTES
_pack_carried_out: Final = _CARRIED_OUT.pack


def carried_out(
    sequence: int,
    ns: int,
    number: int,
    verb: str,
    key: str,
    source: str | None,
    sent_ms: float | None,
    targets: Sequence[tuple[int, ServoOp]],
    data: bytes,
    frame_ns: int,
    transfer_ns: int,
) -> bytes | None:
    """The body of a CarriedOut, for `Ring.put`; None where it needs records of its own, as it does not fit.

    Written out for a leg's three servos: a gait sends nothing else, six times fifty a second.
    """
    after_ns = frame_ns - ns
    texts = _known.get((verb, key, source)) or _texts(verb, key, source)
    rest_bytes = _CARRIED_OUT_HEAD_BYTES + len(texts)
    size = len(data)
    fits = rest_bytes <= ROOM and size <= _MOST_FRAME
    if len(targets) != _OF_A_LEG or not fits or not 0 <= after_ns <= _UINT32:
        return None
    (first, one), (second, two), (third, three) = targets
    fixed = _pack_carried_out(
        HEAD_BYTES + rest_bytes, CARRIED_OUT, 0, sequence, ns,
        after_ns, transfer_ns & _UINT32, size, data,
        number & _UINT32, _SENT_NOT if sent_ms is None else sent_ms, _OF_A_LEG,
        first, _OF_OP[one.op] + one.angle_cdeg,
        second, _OF_OP[two.op] + two.angle_cdeg,
        third, _OF_OP[three.op] + three.angle_cdeg,
    )  # fmt: skip
    return fixed + texts


def event(kind: str, source: str | None, key: str | None, reason: str | None, detail: str, left_out: int) -> bytes:
    """Of an EventTold."""
    fixed = EVENT_HEAD.pack(min(left_out, _UINT32)) + _texts(kind, source, key, reason)
    return (fixed + detail.encode("utf-8", "replace"))[:MAX_TEXT]


def mode(name: str) -> bytes:
    """Of a ModeChange; of an End as well."""
    return name.encode("utf-8", "replace")[:MAX_TEXT]


def number(value: int) -> bytes:
    """Of a Lag or a Clock."""
    return WALL.pack(value)


def incident(wall_ns: int, name: str) -> bytes:
    """Of an IncidentBegun."""
    return WALL.pack(wall_ns) + name.encode()


def calibration(report: Calibration) -> bytes:
    """Of a Calibrated. With all that a calibration may say it has some 1800 bytes."""
    return report.model_dump_json().encode()


def about(facts: dict[str, Any]) -> bytes:
    """Of an About. With all that settings may state it has some 2000 bytes."""
    return json.dumps(facts).encode()
