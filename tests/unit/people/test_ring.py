"""The black box's ring: a record is there whole or not at all, whatever was in the file before."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.model.frames import STOP, Op, ServoOp, stop_leg
from gateway.people.recorder import records as rec
from gateway.people.recorder import ring_reader
from gateway.people.recorder.incidents import MOST, find, is_id
from gateway.people.recorder.ring_reader import NoRingError
from gateway.robot.blackbox.ring import RecordRing
from schemas.robot import SERVO_IDS
from tests.support.ring import parse, put, start
from tests.support.robot import WALL_NS

ALL_LEGS = tuple((servo_id, ServoOp(Op.SET, 180_00)) for servo_id in SERVO_IDS)
FRAME = stop_leg(3).to_bytes()
WRITTEN: list[tuple[int, Callable[..., bytes], Callable[..., rec.Content], tuple[Any, ...]]] = [
    (form.START, start, rec.Start, (5, {"version": "1"})),
    (form.END, form.text, rec.End, ("done",)),
    (
        form.COMMAND,
        form.command,
        rec.CommandRecord,
        (7, "put", "hexapod/leg/3/cmd", "anna", 12.5, ((31, ServoOp(Op.START, 90_25)), (32, STOP))),
    ),
    (form.COMMAND, form.command, rec.CommandRecord, (8, "get", "hexapod/legs/cmd", "ä" * 64, None, ALL_LEGS)),
    (form.DECISION, form.decision, rec.Decision, (7, "stale", "k", None)),
    (form.FRAME, form.frame, rec.FrameWritten, (FRAME, "watchdog", 45_000)),
    (form.MODE, form.text, rec.ModeChange, ("active",)),
    (form.EVENT, form.event, rec.EventPublished, ("bus_fault", None, "k", None, "x" * 500, 3)),
    (form.LAG, form.number, rec.Lag, (20_000_000,)),
    (form.LEFT_OUT, form.left_out, rec.LeftOut, (1234, "anna")),
    (form.LEFT_OUT, form.left_out, lambda _, source: rec.LeftOut(2**32 - 1, source), (2**40, None)),
    (form.INCIDENT, form.at_wall_time, rec.IncidentBegun, (9, "20260101-000000-000-estop")),
]
"""A record's kind, how it is written, what is read of it, and its values."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "black-box"


def image(*records: tuple[int, bytes, int]) -> bytes:
    """A ring of these types, contents and times, in their order."""
    slots = len(records) + 1
    made = bytearray(header.new(slots).ljust(header.file_bytes(slots), b"\0"))
    for number, (kind, rest, ns) in enumerate(records, 1):
        put(made, form.HEADER_BYTES + number * form.SLOT, kind, number, ns, rest)
    return bytes(made)


def filled(path: Path, records: int, slots: int = 50) -> None:
    """A ring with so many modes, numbered from 1."""
    ring = RecordRing(path, slots)
    for number in range(1, records + 1):
        ring.append(form.MODE, number, form.text(str(number)))
    ring.close()


def modes(path: Path) -> list[int]:
    return [
        int(record.content.mode)
        for record in ring_reader.read(path).records
        if isinstance(record.content, rec.ModeChange)
    ]


def test_everything_is_read_as_it_was_written(path: Path) -> None:
    ring = RecordRing(path, 100)
    for ns, (kind, write, _, values) in enumerate(WRITTEN):
        ring.append(kind, ns, write(*values))
    ring.append(99, 0, b"of a later version")
    ring.close()
    content = ring_reader.read(path)
    assert [record.content for record in content.records] == [made(*values) for _, _, made, values in WRITTEN]
    assert [record.ns for record in content.records] == list(range(len(WRITTEN)))
    assert content.damaged == 0


@pytest.mark.parametrize("records", [0, 1, 49, 50, 51, 99, 100, 101, 1234])
def test_the_newest_are_kept_in_their_order(path: Path, records: int) -> None:
    filled(path, records)
    assert modes(path) == list(range(max(1, records - 49), records + 1))


def test_a_text_of_any_characters_is_no_error(path: Path) -> None:
    ring = RecordRing(path, 100)
    for text in ("\ud800", "x" * 300, "é" * 200, "\0\n"):
        ring.append(form.COMMAND, 0, form.command(1, "put", "key", text, None, ()))
        ring.append(form.EVENT, 0, form.event("kind", text, text, text, text * 100, 0))
    ring.close()
    content = ring_reader.read(path)
    assert (len(content.records), content.damaged) == (8, 0)


def test_every_byte_counts(path: Path) -> None:
    """Each byte of a record changed once: it is never read as something else."""
    filled(path, 3)
    data = path.read_bytes()
    whole, damaged, missing = parse(data)
    assert damaged == missing == 0
    begin = form.HEADER_BYTES + 2 * form.SLOT
    used = 4 + 20 + len(b"2")
    for offset in range(used):
        changed = bytearray(data)
        changed[begin + offset] ^= 0x10
        left, damaged, missing = parse(bytes(changed))
        assert (list(left), damaged, missing) == ([record for record in whole if record.sequence != 2], 1, 1)


@pytest.mark.parametrize(
    ("found", "note"),
    [
        (b"#!/bin/sh\n" * 1000, "it is no black box"),
        (b"short", "it has no header"),
        (header.new(40).ljust(header.file_bytes(40), b"\0"), "it has 40 records, and the settings want 50"),
        (header.new(50), "it has 4096 bytes, and its header states 50 records"),
        (header.new(50).replace(b"\n\x02", b"\n\x01").ljust(header.file_bytes(50), b"\0"), "it has version 1"),
    ],
)
def test_another_file_is_begun_anew_and_said(path: Path, found: bytes, note: str) -> None:
    path.write_bytes(found)
    path.chmod(0o600)
    ring = RecordRing(path, 50)
    assert ring.note.startswith(f"the black box starts empty: {note}")
    ring.append(form.MODE, 0, form.text("1"))
    ring.close()
    assert modes(path) == [1]
    assert path.stat().st_blocks * 512 >= path.stat().st_size, "no hole that a full disk would turn into SIGBUS"


def test_two_gateways_never_write_to_one_ring(path: Path) -> None:
    ring = RecordRing(path, 50)
    assert ring_reader.read(path).written
    with pytest.raises(OSError, match="another gateway writes to it"):
        RecordRing(path, 50)
    ring.close()
    assert not ring_reader.read(path).written
    RecordRing(path, 50).close()


def test_nobody_else_may_have_put_the_file_there(path: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "secret"
    elsewhere.write_text("mine")
    path.symlink_to(elsewhere)
    with pytest.raises(OSError, match="symbolic links"):
        RecordRing(path, 50)
    path.unlink()
    os.link(elsewhere, path)
    with pytest.raises(PermissionError, match="belongs to another user"):
        RecordRing(path, 50)
    assert elsewhere.read_text() == "mine"


def test_a_reader_says_what_it_cannot_read(path: Path, tmp_path: Path) -> None:
    for bad, sentence in ((tmp_path / "none", "No such file"), (tmp_path, "it is no black box|Is a directory")):
        with pytest.raises(NoRingError, match=sentence):
            ring_reader.read(bad)
    os.mkfifo(path)
    with pytest.raises(NoRingError, match="it is no black box"):
        ring_reader.read(path)


def test_a_cut_off_or_mistaken_setpoint_is_damage() -> None:
    targets = ((31, STOP), (32, STOP), (33, STOP))
    body = form.carried_out(1, 0, 7, "put", "k", "anna", None, targets, FRAME, 5, 5)
    assert body is not None
    rest = body[form.HEAD_BYTES :]
    bad = [rest[:length] for length in range(len(rest))]
    bad += [rest[:8] + bytes((15,)) + rest[9:], rest[:-1] + b"\xff"]
    for each in bad:
        records, damaged, missing = parse(image((form.CARRIED_OUT, each, 0)))
        assert (len(records), damaged, missing) == (0, 1, 0)


# ---- rings that no gateway wrote, or one with the largest that settings allow: what reading them costs is bounded


def begun(number: int) -> tuple[int, bytes]:
    name = f"20260921-{number // 60_000:02d}{number // 1000 % 60:02d}13-{number % 1000:03d}-watchdog"
    return form.INCIDENT, form.at_wall_time(WALL_NS + number, name)


@pytest.mark.parametrize("what", [begun, lambda _: (form.START, start(WALL_NS, {}))], ids=["incidents", "starts"])
def test_a_ring_of_nothing_but_incidents_is_no_endless_work(what: Callable[[int], tuple[int, bytes]]) -> None:
    records, _, _ = parse(image(*((*what(number), number * 1_000_000) for number in range(1, 5_001))))
    decoded: list[int] = []

    def counted(index: int) -> rec.Record:
        decoded.append(index)
        return records[index]

    found = find(ring_reader.Records(records.times_ns, records.kinds, counted), written=True)
    assert len(found) == MOST
    assert found[-1].zero_ns >= 4_999 * 1_000_000, "the newest"
    assert [each.zero_ns for each in found] == sorted(each.zero_ns for each in found)
    assert len(decoded) <= 10_000 + MOST * 400, "each some times, and not once for each of the others"


@pytest.mark.parametrize(("name", "good"), [
    ("20260921-141320-123-watchdog", True),
    ("20260931-141320-123-watchdog", False),
    ("20260921-246060-123-watchdog", False),
    ("00000101-000000-000-crash", False),
    ("../../etc/passwd", False),
])  # fmt: skip
def test_an_id_begins_with_a_time(name: str, good: bool) -> None:
    assert is_id(name) is good


@pytest.mark.parametrize("sequence", [0, 2**63, 2**64 - 1])
def test_a_gateway_does_not_run_out_of_sequence_numbers(path: Path, sequence: int) -> None:
    filled(path, 1, 15)  # divides 2**64 - 1
    image = bytearray(path.read_bytes())
    offset = form.HEADER_BYTES + sequence % 15 * form.SLOT
    put(image, offset, form.MODE, sequence, 2, form.text("idle"))
    path.write_bytes(image)
    assert [record.sequence for record in ring_reader.read(path).records] == [1]
    filled(path, 1, 15)
    assert [record.sequence for record in ring_reader.read(path).records] == [1, 2]


# ---- values out of range


@pytest.mark.parametrize(
    "told",
    [
        b"{",
        b"[" * 1500,
        b'{"revision":1,"servos":{"77":{}},"landing":{}}',
        b'{"revision":1,"servos":{"31":{"trim_deg":1e999}},"landing":{}}',
        b'{"revision":1,"servos":{},"landing":{"31":NaN}}',
        b'{"revision":1,"servos":{},"landing":{"\xc2\xb2":1}}',
        b"",
    ],
    ids=repr,
)
def test_a_calibration_that_no_gateway_published_is_damaged_and_in_the_header_unknown(told: bytes) -> None:
    ring = bytearray(image((form.CALIBRATION, told[: form.ROOM], 1)))
    header.put_calibration(ring, told)
    records, damaged, _ = parse(bytes(ring))
    assert (len(records), damaged) == (0, 1)
    assert records.calibration_at(1) is None


def test_a_calibration_that_does_not_fit_the_header_is_unknown() -> None:
    ring = bytearray(image())
    header.put_calibration(ring, b"{}" * 2000)
    assert header.calibration(bytes(ring)) == b""
    header.put_calibration(ring, b'{"revision":1,"servos":{},"landing":{}}')
    assert parse(bytes(ring))[0].calibration_at(1) is not None
    ring[140] ^= 1
    assert header.calibration(bytes(ring)) == b"", "half of it was written"


@pytest.mark.parametrize("fact", ["\ud800", [[[]]], {"a": 1}], ids=repr)
def test_a_start_with_facts_that_no_file_takes_is_damaged(fact: object) -> None:
    records, damaged, _ = parse(image((form.START, start(WALL_NS, {"pid": fact}), 1)))
    assert (len(records), damaged) == (0, 1)
    records, damaged, _ = parse(image((form.START, start(WALL_NS, {"\udfff": 1}), 1)))
    assert (len(records), damaged) == (0, 1)
