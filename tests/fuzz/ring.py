"""The black box on rings that no gateway wrote, in four steps: reading, incidents, their files, and the ring's file.

For each: nothing but the errors that it says, and what comes of an input of these bytes takes no more steps and no more
memory than inputs of its size may.
"""

import json
import os
import sys
import tempfile
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import IO, Any, Final, NamedTuple, TypeVar
from zlib import crc32

from mcap.reader import make_reader

from gateway.host.file_lock import written_by_anyone
from gateway.model.black_box import format as form
from gateway.model.black_box import header
from gateway.people.incidents import archive, ring_reader
from gateway.people.incidents.incidents import CRASH, MOST, Incident, find, is_id, kind_of, time_of
from gateway.people.incidents.messages import COMMAND_TOPICS, RECORDER, messages
from gateway.people.incidents.story import story
from gateway.people.recordings import REPORTS, RecordedMessage, read
from gateway.robot.blackbox.ring import RecordRing
from tests.fuzz import ring_reference
from tests.fuzz.ring_image import image_of


class Bounds(NamedTuple):
    """For each byte of an input: lines of the black box's Python code, and bytes of memory."""

    steps: int
    memory: int


STEPS: Final = 4_000
MEMORY: Final = 60_000
"""Of an input without bytes."""
READING: Final = Bounds(steps=1, memory=8)
TELLING: Final = Bounds(steps=60, memory=20)
"""Unprintable text takes the most: a name is in the lines of six legs, and each of its characters is looked at. Large
rings, where the memory matters, are in tests/unit/people/test_ring_hostile.py."""
BOUNDED: Final = ("/blackbox/", "/incidents/")
"""Folders whose lines are counted."""
COUNTED: Final = 64
"""One input in so many is counted: it then takes twenty times as long."""
MEASURED: Final = 4_096
"""One in so many is measured: each time, Python keeps a kilobyte for good."""
FEW_SLOTS: Final = 5
"""A smaller ring does not hold all that `_go_on` writes."""
NOW_NS: Final = 30 * 1_000_000_000
Made = TypeVar("Made")
TOPICS: Final = frozenset({*COMMAND_TOPICS, *REPORTS, RECORDER})


def bounded(work: Callable[[bytes], Made], bounds: Bounds) -> Callable[[bytes], Made]:
    """`work`, which is stopped after its most steps for some of the inputs, and measured for some others."""

    def run(data: bytes) -> Made:
        number = crc32(data)  # so that what was found is found again
        if number % COUNTED == 0:
            return _counted(work, data, STEPS + len(data) * bounds.steps)
        if number % MEASURED == 1:
            return _measured(work, data, MEMORY + len(data) * bounds.memory)
        return work(data)

    return run


def _counted(work: Callable[[bytes], Made], data: bytes, most: int) -> Made:
    left = most

    def line(_frame: FrameType, event: str, _argument: object) -> Any:
        nonlocal left
        left -= event == "line"
        assert left > 0, f"more than {most} steps for {len(data)} bytes"
        return line

    def call(frame: FrameType, _event: str, _argument: object) -> Any:
        return line if any(part in frame.f_code.co_filename for part in BOUNDED) else None

    before = sys.gettrace()
    sys.settrace(call)
    try:
        return work(data)
    finally:
        sys.settrace(before)


def _measured(work: Callable[[bytes], Made], data: bytes, most: int) -> Made:
    tracemalloc.start()
    try:
        made = work(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= most, f"{peak} bytes of memory for {len(data)}"
    return made


# ---- reading


def _parse(data: bytes) -> tuple[ring_reader.Records, int, int] | None:
    try:
        return ring_reader.parse(image_of(data))
    except form.DamagedRingError:
        return None


_parse_bounded: Final = bounded(_parse, READING)


def fuzz_ring(data: bytes) -> str:
    """A ring in memory is read as by another reader, and what its records say can be written again."""
    found, wanted = _parse_bounded(data), ring_reference.records(image_of(data))
    assert (found is None) is (wanted is None)
    if found is None or wanted is None:
        return "no ring"
    records, damaged, missing = found
    assert (damaged, missing) == wanted[1:]
    assert list(records.times_ns) == [record.ns for record in wanted[0]]
    assert len(records) == len(records.kinds)
    again = list(records)
    assert again == wanted[0] or repr(again) == repr(wanted[0]), "as text, for what is no number is not equal to itself"
    return "damaged" if damaged else "whole" if wanted[0] else "empty"


# ---- incidents


class _Told(NamedTuple):
    """What becomes of a ring's records."""

    records: ring_reader.Records
    incidents: list[Incident]
    messages: list[list[RecordedMessage]]
    stories: list[list[str]]


def _tell(data: bytes) -> _Told | None:
    """The lowest bits of the first byte say whether a gateway writes to the ring, and whether it is long ago."""
    parsed = _parse(data)
    if parsed is None:
        return None
    records = parsed[0]
    incidents = find(records, written=bool(data[0] & 1), now_ns=NOW_NS if data[0] & 2 else 0)
    made = [list(messages(incident, records)) for incident in incidents[-2:]]
    return _Told(records, incidents, made, [story(each) for each in made])


_tell_bounded: Final = bounded(_tell, TELLING)


def fuzz_incidents(data: bytes) -> str:
    """What is found has names that are safe, and is no more than is kept; each is messages, and a story."""
    told = _tell_bounded(data)
    if told is None:
        return "no ring"
    assert len(told.incidents) <= MOST
    for incident in told.incidents:
        assert is_id(incident.name)
        assert "/" not in incident.name
        assert time_of(incident.name)
        assert incident.begin_ns <= incident.zero_ns <= incident.end_ns
    for made in told.messages:
        for message in made:
            assert message.topic in TOPICS
            json.dumps(message.content, allow_nan=False, ensure_ascii=False).encode()
    for lines in told.stories:
        assert all(line.isprintable() for line in lines), lines
    kinds = {kind_of(incident.name) for incident in told.incidents}
    return ("crash" if CRASH in kinds else "others") if kinds else "no incident"


# ---- files


def _folder() -> tempfile.TemporaryDirectory[str]:
    """In memory, where a machine has such a place: what is fuzzed is not its disk."""
    memory = "/dev/shm"  # noqa: S108
    return tempfile.TemporaryDirectory(prefix="fuzz-ring-", dir=memory if os.access(memory, os.W_OK) else None)


def fuzz_export(data: bytes) -> str:
    """The file of the newest incident is read by MCAP's own reader, and tells the same story."""
    told = _tell(data)
    if told is None or not told.incidents:
        return "no incident"
    with _folder() as folder:
        path = archive.keep(Path(folder), told.incidents[-1], told.records)
        assert [each.name for each in archive.kept(Path(folder))] == [path.stem]
        with path.open("rb") as file:
            of_mcap = [channel.topic for _, channel, _ in _iterate(file)]
        again = [each for each in read(path) if each.topic in TOPICS]
    assert sorted(topic for topic in of_mcap if topic in TOPICS) == sorted(each.topic for each in again)
    assert story(again) == told.stories[-1]
    return "exported"


def _iterate(file: IO[bytes]) -> Any:
    return make_reader(file, validate_crcs=True).iter_messages()


def fuzz_ring_file(data: bytes) -> str:
    """The ring's file is read while it is changed, or says why not; a gateway goes on with it, or begins it anew."""
    image, options = image_of(data), data[0] if data else 0
    change = list(UNDER_WAY)[options % len(UNDER_WAY)]
    with _folder() as folder:
        path = Path(folder) / "ring"
        path.write_bytes(image)
        seen = _read_while(path, lambda: UNDER_WAY[change](path, image))
        if change == "nothing":
            _check_same(image, seen)
        path.chmod(0o600)
        note = _go_on(path)
    return f"{change}, {'begun anew' if 'anew' in note else 'torn' if note else 'continued'}"


def _nothing(_path: Path, _image: bytes) -> None:
    pass


def _cut(path: Path, image: bytes) -> None:
    os.truncate(path, crc32(image) % (len(image) + 1))


def _grow(path: Path, image: bytes) -> None:
    with path.open("ab") as file:
        file.write(image[-form.SLOT :] * 3)


def _overwrite(path: Path, image: bytes) -> None:
    """Half of its slots are those of the next round, and one of them is half written."""
    with path.open("r+b") as file:
        file.seek(min(form.HEADER_BYTES, len(image)))
        file.write(image[form.HEADER_BYTES + form.SLOT :][: len(image) // 2 + form.SLOT // 2])


UNDER_WAY: Final = {"nothing": _nothing, "cut": _cut, "growing": _grow, "written to": _overwrite}


def _read_while(path: Path, change: Callable[[], None]) -> ring_reader.Content | None:
    """Read it; the change comes when its size is known and nothing is read."""

    def changed(fd: int) -> bool:
        change()
        return written_by_anyone(fd)

    ring_reader.written_by_anyone = changed  # type: ignore[attr-defined]
    try:
        return ring_reader.read(path)
    except ring_reader.NoRingError:
        return None
    finally:
        ring_reader.written_by_anyone = written_by_anyone  # type: ignore[attr-defined]


def _check_same(image: bytes, seen: ring_reader.Content | None) -> None:
    try:
        records, damaged, missing = ring_reader.parse(image)
    except form.DamagedRingError:
        assert seen is None
        return
    assert seen is not None
    assert (repr(list(seen.records)), seen.damaged, seen.missing) == (repr(list(records)), damaged, missing)


def _go_on(path: Path) -> str:
    """A gateway opens it and writes: what it wrote is the newest that is there. Returns what it says of the file."""
    try:
        slots = header.slots_of(path.read_bytes()[: form.HEADER_BYTES], path.stat().st_size)
    except form.DamagedRingError:
        slots = 5
    ring = RecordRing(path, slots)
    try:
        first = ring.sequence
        for number in range(3):
            ring.append(form.MODE, number, form.mode(str(number)))
        ring.append(form.EVENT, 3, form.event("bus_fault", None, None, None, "x" * form.ROOM, 0))
        assert ring_reader.read(path).written
    finally:
        ring.close()
    content = ring_reader.read(path)
    assert path.stat().st_size == header.file_bytes(slots)
    assert not content.written
    there = [(each.sequence, each.content) for each in content.records[-4:]]
    wanted: list[tuple[int, form.Content]] = [(first + number, form.ModeChange(str(number))) for number in range(3)]
    wanted.append((first + 3, form.EventPublished("bus_fault", None, None, None, "x" * form.ROOM, 0)))
    # Whoever forges the last of all numbers makes a gateway's records unreadable, and does no more harm.
    assert there == wanted or slots < FEW_SLOTS or first > form.MAX_SEQUENCE - 4, (there, wanted)
    return ring.note
