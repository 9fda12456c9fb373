"""Rings that no gateway wrote, or one with the largest that settings allow: what reading them costs is bounded."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.people.recorder import ring_reader
from gateway.people.recorder.incidents import MOST, find, is_id
from gateway.robot.blackbox.ring import RecordRing
from tests.support.ring import parse
from tests.support.robot import WALL_NS


def ring_of(slots: int, record: Callable[[int], tuple[int, bytes]]) -> bytes:
    """A full ring's bytes; `record` says what has each sequence number. One a millisecond."""
    image = bytearray(header.new(slots).ljust(header.file_bytes(slots), b"\0"))
    for number in range(1, slots + 1):
        kind, rest = record(number)
        form.put(image, form.HEADER_BYTES + number % slots * form.SLOT, kind, number, number * 1_000_000, rest)
    return bytes(image)


def begun(number: int) -> tuple[int, bytes]:
    name = f"20260921-{number // 60_000:02d}{number // 1000 % 60:02d}13-{number % 1000:03d}-watchdog"
    return form.INCIDENT, form.incident(WALL_NS + number, name)


@pytest.mark.parametrize("what", [begun, lambda _: (form.START, form.start(WALL_NS, {}))], ids=["incidents", "starts"])
def test_a_ring_of_nothing_but_incidents_is_no_endless_work(what: Callable[[int], tuple[int, bytes]]) -> None:
    records, _, _ = parse(ring_of(5_000, what))
    decoded: list[int] = []

    def counted(index: int) -> form.Record:
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
def test_a_gateway_does_not_run_out_of_sequence_numbers(tmp_path: Path, sequence: int) -> None:
    path = tmp_path / "ring"
    ring = RecordRing(path, 15)  # divides 2**64 - 1
    ring.append(form.MODE, 1, form.mode("active"))
    ring.close()
    image = bytearray(path.read_bytes())
    offset = form.HEADER_BYTES + sequence % 15 * form.SLOT
    form.put(image, offset, form.MODE, sequence, 2, form.mode("idle"))
    path.write_bytes(image)
    assert [record.sequence for record in ring_reader.read(path).records] == [1]
    ring = RecordRing(path, 15)
    ring.append(form.MODE, 3, form.mode("idle"))
    ring.close()
    assert [record.sequence for record in ring_reader.read(path).records] == [1, 2]


# ---- found by the fuzzer


def image(*records: tuple[int, int, bytes]) -> bytes:
    """A ring of these types, times and contents, in their order."""
    slots = len(records) + 1
    made = bytearray(header.new(slots).ljust(header.file_bytes(slots), b"\0"))
    for number, (kind, ns, rest) in enumerate(records, 1):
        form.put(made, form.HEADER_BYTES + number * form.SLOT, kind, number, ns, rest)
    return bytes(made)


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
    ring = bytearray(image((form.CALIBRATION, 1, told[: form.ROOM])))
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
    records, damaged, _ = parse(image((form.START, 1, form.start(WALL_NS, {"pid": fact}))))
    assert (len(records), damaged) == (0, 1)
    records, damaged, _ = parse(image((form.START, 1, form.start(WALL_NS, {"\udfff": 1}))))
    assert (len(records), damaged) == (0, 1)
