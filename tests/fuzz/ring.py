"""The black box's reader and exporter on rings that no gateway wrote: a ring is made of the input's bytes.

Byte 1 picks the number of slots, byte 2 whether a gateway writes to it now, and whether an incident is exported, which
is slow. Then records: flags, type, slot, two bytes of time, length, content.
"""

import json
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Final

from gateway.protocol.frames import STOP, Op, ServoOp, stop_leg
from gateway.recorder import format as form
from gateway.recorder import kept, reader
from gateway.recorder.incidents import find, is_id
from gateway.recorder.messages import messages
from gateway.recorder.story import story
from gateway.recordings import read
from schemas.keys import ESTOP, leg_command

WALL_NS: Final = 1_790_000_000_000_000_000
STEP_NS: Final = 100_000_000
LEG_3: Final = leg_command(3)
SET_LEG_3: Final = tuple((30 + joint, ServoOp(Op.SET, 90_25)) for joint in (1, 2, 3))
CARRIED_OUT_BODY: Final = (
    form.carried_out(1, 0, 8, "put", LEG_3, "anna", 12.5, SET_LEG_3, stop_leg(3).to_bytes(), 80_000, 45_000) or b""
)
CONTENTS: Final = (
    (form.START, form.start(WALL_NS, {"pid": 1})),
    (form.END, form.mode("done")),
    (form.COMMAND, form.command(7, "put", LEG_3, "anna", 12.5, ((31, ServoOp(Op.SET, 90_25)), (32, STOP)))),
    (form.COMMAND, form.command(0, "get", ESTOP, None, None, ())),
    (form.DECISION, form.decision(7, "accepted", LEG_3, "anna")),
    (form.DECISION, form.decision(0, "malformed", LEG_3, "\x1b[2J")),
    (form.FRAME, form.frame(stop_leg(3).to_bytes(), "watchdog", 45_000, 300_000)),
    (form.FRAME, form.frame(stop_leg(3).to_bytes(), "repeat", 45_000)),
    (form.CARRIED_OUT, CARRIED_OUT_BODY[form.HEAD_BYTES :]),
    (form.MODE, form.mode("estopped")),
    (form.EVENT, form.event("watchdog_expired", None, None, None, "leg 3 was not heard", 0)[: form.ROOM]),
    (form.LAG, form.number(20_000_000)),
    (form.CLOCK, form.number(WALL_NS)),
    (form.INCIDENT, form.incident(WALL_NS, "20260921-141320-123-watchdog")),
    (form.INCIDENT, form.incident(WALL_NS, "20260921-141321-123-estop")),
)
"""What a gateway writes; the other half of the records has content of the fuzzer's own."""
EXPORT: Final = 14
GOOD_CHECKSUM, OWN_CONTENT, MORE, NEAR = 1, 2, 4, 8


def ring_of(data: bytes) -> bytes:
    """A ring's file."""
    slots = 1 + data[0] % 40
    image = bytearray(form.header(slots).ljust(form.file_bytes(slots), b"\0"))
    position, sequence, ns = 2, 0, 20 * 1_000_000_000
    while position + 6 <= len(data):
        flags, kind, slot, high, low, length = data[position : position + 6]
        rest = data[position + 6 : position + 6 + length % (form.ROOM + 1)]
        position += 6 + len(rest)
        sequence = sequence + 1 if flags & NEAR else slot
        ns = ns + low * STEP_NS // 10 if flags & NEAR else (high << 56) + low * STEP_NS
        if not flags & OWN_CONTENT:
            kind, rest = CONTENTS[kind % len(CONTENTS)]
        offset = form.HEADER_BYTES + sequence % slots * form.SLOT
        form.put(image, offset, kind, sequence, min(ns, 2**63 - 1), rest, bool(flags & MORE))
        if not flags & GOOD_CHECKSUM:
            image[offset] ^= 1
    return bytes(image)


def fuzz_ring(data: bytes) -> str:
    """What is in it is read in order, and each incident becomes printable lines, and messages that are JSON."""
    if len(data) < 2:
        return "too short"
    image = ring_of(data)
    records, damaged, missing = reader.parse(image)
    slots = (len(image) - form.HEADER_BYTES) // form.SLOT
    assert 0 <= len({record.sequence for record in records}) + damaged <= slots
    assert 0 <= missing <= slots
    assert all(
        earlier.sequence < later.sequence
        or (isinstance(earlier.content, form.CommandRecord) and earlier.ns <= later.ns)
        for earlier, later in pairwise(records)
    ), "only a command and its frame have one number"
    found = find(records, written=bool(data[1] & 1), now_ns=30 * 1_000_000_000)
    for incident in found:
        assert is_id(incident.name)
        made = list(messages(incident, records))
        for message in made:
            json.dumps(message.content, allow_nan=False)
        lines = story(made)
        assert all(line.isprintable() for line in lines), lines
    if found and data[1] % 16 == EXPORT:
        with tempfile.TemporaryDirectory() as folder:
            path = kept.keep(Path(folder), found[-1], records)
            assert story(list(read(path))) == story(list(messages(found[-1], records)))
        return "exported"
    return f"{'incidents' if found else 'records' if records else 'nothing'}"


def seeds() -> list[bytes]:
    """Rings as a gateway writes them, and records one by one."""
    good = GOOD_CHECKSUM | NEAR
    every = b"".join(bytes((good, kind, 0, 0, 5, 0)) for kind in range(len(CONTENTS)))
    long = bytes((good | OWN_CONTENT | MORE, form.EVENT, 0, 0, 1, 20)) + b"\0" * 20
    continued = long + bytes((good | OWN_CONTENT, form.MORE, 0, 0, 1, 4)) + b"more"
    return [
        bytes((39, EXPORT)) + every,
        bytes((39, 1)) + every + every,
        bytes((5, 3)) + every * 3,
        bytes((20, 1)) + every[:18] + continued + every[6 * 12 :],
        bytes((39, 0)) + every[:72] + bytes((good, 0, 0, 0, 255, 0)) + every[72:],
        *(bytes((3, 0)) + bytes((GOOD_CHECKSUM, kind, 1, 0, 9, 0)) for kind in range(len(CONTENTS))),
    ]
