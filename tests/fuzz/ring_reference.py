"""A ring's reader once more, written another way, and what its records say written again.

The reader is compared with it. They share what one record's content means, which is checked by writing it again.
"""

import struct
from typing import Final
from zlib import crc32

from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.people.incidents.ring_decoding import decode

_Slot = tuple[int, int, bool, bytes]
"""Type, time, whether it is continued, and content."""


def records(image: bytes) -> tuple[list[form.Record], int, int] | None:
    """The records, oldest first, how many slots are damaged, and how many missing; None: it is no ring."""
    magic, version, size, slots = struct.unpack("<18sHII", image[:28].ljust(28, b"\0"))
    wanted = (header.MAGIC, header.VERSION, form.SLOT, form.HEADER_BYTES + slots * form.SLOT)
    if not slots or (magic, version, size, len(image)) != wanted:
        return None
    good, damaged = _good_slots(image, slots)
    last = max(good, default=0)
    for sequence in list(good):
        if sequence <= last - slots:
            del good[sequence]
    found = []
    for sequence in sorted(good):
        kind, ns, more, rest = good[sequence]
        if kind == form.MORE:
            continue
        following = sequence + 1
        try:
            while more:
                if len(rest) > form.MAX_TEXT or good[following][0] != form.MORE:
                    raise KeyError(following)
                more, rest, following = good[following][2], rest + good[following][3], following + 1
            content = decode(kind, ns, rest)
        except (KeyError, form.DamagedRingError):
            damaged += 1
            continue
        if content is None:
            continue
        check_content(kind, ns, rest, content)
        if isinstance(content, form.CarriedOut):
            found.append(form.Record(sequence, ns, content.command))
            found.append(form.Record(sequence, content.frame_ns, content.frame))
        else:
            found.append(form.Record(sequence, ns, content))
    return found, damaged, last - min(good) + 1 - len(good) if good else 0


def _good_slots(image: bytes, slots: int) -> tuple[dict[int, _Slot], int]:
    """By sequence number; and how many others have something in them."""
    good: dict[int, _Slot] = {}
    damaged = 0
    for place, at in enumerate(range(form.HEADER_BYTES, len(image), form.SLOT)):
        slot = image[at : at + form.SLOT]
        checksum, length, kind, more, sequence, ns = struct.unpack("<IHBBQq", slot[:24])
        whole = 20 <= length <= 124 and checksum == crc32(slot[4 : 4 + length])
        if whole and 0 < sequence < 2**63 and 0 <= ns < 2**62 and sequence % slots == place:
            good[sequence] = kind, ns, more > 0, slot[24 : 4 + length]
        elif slot != bytes(form.SLOT):
            damaged += 1
    return good, damaged


_checked: set[tuple[int, bytes]] = set()
MAX_CHECKED: Final = 1_000
"""Most inputs share most of their records with others."""


def check_content(kind: int, ns: int, rest: bytes, content: form.Content | form.CarriedOut) -> None:
    """What was read is written, and read again as the same."""
    if (kind, rest) in _checked:
        return
    written = carried_out(ns, content) if isinstance(content, form.CarriedOut) else encoded(content)
    if written is not None and len(written) <= form.MAX_TEXT:
        assert repr(decode(kind, ns, written)) == repr(content), written.hex()
    if len(_checked) >= MAX_CHECKED:
        _checked.clear()
    _checked.add((kind, rest))


def carried_out(ns: int, content: form.CarriedOut) -> bytes | None:
    """As a recorder writes it; None: it does so for a leg only."""
    command, frame = content.command, content.frame
    named = command.number, command.verb, command.key, command.source, command.sent_ms, command.targets
    body = form.carried_out(1, ns, *named, frame.data, content.frame_ns, frame.transfer_ns)
    return None if body is None else body[form.HEAD_BYTES :]


def encoded(content: form.Content) -> bytes:
    """As a recorder writes it."""
    match content:
        case form.Start(wall_ns, facts):
            made = form.start(wall_ns, facts)
        case form.End(text) | form.ModeChange(text):
            made = form.mode(text)
        case form.CommandRecord(number, verb, key, source, sent_ms, targets):
            made = form.command(number, verb, key, source, sent_ms, targets)
        case form.Decision(number, verdict, key, source):
            made = form.decision(number, verdict, key, source)
        case form.FrameWritten(data, cause, transfer_ns, late_ns, number):
            made = form.frame(data, cause, transfer_ns, late_ns, number)
        case form.EventPublished(kind, source, key, reason, detail, left_out):
            made = form.event(kind, source, key, reason, detail, left_out)
        case form.Lag(ns) | form.Clock(ns):
            made = form.number(ns)
        case form.LeftOut(count, source):
            made = form.left_out(count, source)
        case form.IncidentBegun(wall_ns, name):
            made = form.incident(wall_ns, name)
        case form.Calibrated(report):
            made = form.calibration(report)
        case form.About(facts):
            made = form.about(facts)
        case form.BodyState(values):
            made = form.measured(values)
    return made
