"""Damaged recordings: what is not damaged is read, what is lost is counted, and no file is destroyed."""

import json
import os
import random
import tracemalloc
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Final, NamedTuple

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from gateway.errors import ConfigError
from gateway.people.recordings import ReadLosses, Recording, read
from gateway.people.recordings.contents import cut
from gateway.people.recordings.pieces import MCAP_MAGIC
from gateway.people.recordings.reading import records
from gateway.people.recordings.unpacking import MAX_UNPACKED_BYTES
from schemas import keys
from tests.unit.people.test_recordings import START_NS, recorded, reports

pytestmark = pytest.mark.full

Contents = list[tuple[str, bytes]]
HEAD_BYTES: Final = 9
"""Of a record: its type and length."""


class Place(NamedTuple):
    """Where a chunk is in its file, and the numbers of its messages."""

    begin: int
    end: int
    first: int
    behind: int


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ride.mcap"


@pytest.fixture(scope="module", name="made")
def make_ride(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A whole recording, of some fifteen chunks."""
    path = tmp_path_factory.mktemp("ride") / "ride.mcap"
    recorded(path, 2000).close()
    return path.read_bytes()


@pytest.fixture
def ride(path: Path, made: bytes) -> bytes:
    """The same, at `path`."""
    path.write_bytes(made)
    return made


def contents(path: Path, losses: ReadLosses | None = None) -> Contents:
    """All messages, of whichever encoding."""
    topics: dict[int, str] = {}
    found: Contents = []
    for record in records(path, losses):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and record.channel_id in topics:
            found.append((topics[record.channel_id], record.data))
    return found


def places(data: bytes) -> list[Place]:
    """As mcap's own reader finds them."""
    chunks = [each for each in StreamReader(BytesIO(data), emit_chunks=True).records if isinstance(each, Chunk)]
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    counts = [sum(isinstance(each, Message) for each in breakup_chunk(chunk)) for chunk in chunks]
    found, number = [], 0
    for count, index in zip(filter(None, counts), summary.chunk_indexes, strict=True):
        begin = index.chunk_start_offset
        found.append(Place(begin, begin + index.chunk_length, number, number + count))
        number += count
    return found


def flipped(data: bytes, at: int, chance: random.Random) -> bytes:
    return data[:at] + bytes([data[at] ^ chance.randrange(1, 256)]) + data[at + 1 :]


@pytest.mark.parametrize("cut", [False, True], ids=["a whole file", "a cut one"])
def test_of_each_damaged_chunk_only_its_own_messages_are_missing(path: Path, ride: bytes, cut: bool) -> None:
    """Wherever in it a byte is wrong: in its length, its checksum, or what it has packed."""
    all_places = places(ride)
    assert len(all_places) > 12
    if cut:
        all_places, ride = all_places[:-1], ride[: all_places[-1].end - 7]
    path.write_bytes(ride)
    whole = contents(path)
    assert len(whole) == all_places[-1].behind
    chance = random.Random(3)  # noqa: S311
    for number, place in enumerate(all_places):
        heads = [place.begin, place.begin + 1, place.begin + 3, place.begin + HEAD_BYTES + 16, place.begin + 46]
        for at in (place.begin, heads[number % len(heads)], chance.randrange(place.begin, place.end), place.end - 1):
            path.write_bytes(flipped(ride, at, chance))
            losses = ReadLosses()
            found = contents(path, losses)
            rest = whole[: place.first] + whole[place.behind :]
            if found == whole:  # its time, which nobody reads
                assert place.begin + HEAD_BYTES <= at < place.begin + HEAD_BYTES + 16
                continue
            assert found == rest, (number, at - place.begin)
            later = {topic for topic, _ in whole[place.behind :]}
            assert losses.missing == sum(topic in later for topic, _ in whole[place.first : place.behind])
            assert losses
            assert losses.cut_off == cut or place is all_places[-1]


def test_a_piece_of_a_damaged_one_is_a_whole_file_and_the_damaged_one_stays(path: Path, ride: bytes) -> None:
    whole = contents(path)
    _, place, *_ = places(ride)
    damaged = flipped(ride, place.end - 1, random.Random(4))  # noqa: S311
    for data in (damaged, damaged[:-2000]):
        path.write_bytes(data)
        into = path.with_name(f"whole-{len(data)}.mcap")
        assert cut(path, into, from_s=0, to_s=1e9)
        assert path.read_bytes() == data
        readable = contents(path)
        assert readable == [*whole[: place.first], *whole[place.behind :]][: len(readable)]
        assert len(readable) > 0.6 * len(whole)
        assert contents(into) == readable
        with into.open("rb") as file:
            messages = make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
            assert [(channel.topic, message.data) for _, channel, message in messages] == readable


def test_whatever_is_damaged_reading_ends_and_finds_no_more_than_there_was(path: Path, ride: bytes) -> None:
    whole = contents(path)
    texts = set(map(repr, whole))
    chance = random.Random(8)  # noqa: S311
    for _ in range(40):
        data = bytearray(ride[: chance.randrange(len(ride) // 2, len(ride) + 1)])
        for _ in range(chance.randrange(1, 20)):
            begin = chance.randrange(len(MCAP_MAGIC), len(data))
            data[begin : begin + chance.choice([1, 1, 1, 1000])] = chance.randbytes(chance.choice([0, 1, 1, 50]))
        path.write_bytes(data)
        losses = ReadLosses()
        found = contents(path, losses)
        assert set(map(repr, found)) <= texts
        assert losses or losses.cut_off or len(found) == len(whole)


# ---- made to harm


def write_chunks(path: Path, *chunks: Chunk) -> None:
    """A file with these chunks behind a channel."""
    with Recording(path, time_ns=START_NS):
        pass
    data = path.read_bytes()
    end = places(data)[-1].end
    made = RecordBuilder()
    for chunk in chunks:
        chunk.write(made)
    path.write_bytes(data[:end] + made.end())


def a_chunk(compression: str, data: bytes, size: int, checksum: int = 0) -> Chunk:
    return Chunk(compression, data, START_NS, START_NS, checksum, size)


def messages_of(count: int) -> bytes:
    """The smallest there are."""
    made = RecordBuilder()
    message = Message(channel_id=1, log_time=0, data=b"", publish_time=0, sequence=0)
    message.write(made)
    one: bytes = made.end()
    return one * count


BOMB: Final = bytes(4 * MAX_UNPACKED_BYTES)


@pytest.mark.parametrize(
    "chunk",
    [
        a_chunk("zstd", zstandard.compress(BOMB), len(BOMB)),
        a_chunk("zstd", zstandard.compress(BOMB), 1000),
        a_chunk("lz4", lz4.frame.compress(BOMB), 1000),
        a_chunk("zstd", zstandard.ZstdCompressor(write_content_size=False).compress(BOMB), 1000),
        a_chunk("zstd", zstandard.compress(messages_of(400_000)), 400_000 * 31),
        a_chunk("", b"x" * 100, 2**60),
        a_chunk("zstd", b"", 0, 7),
    ],
    ids=["large", "more than it states", "lz4", "an unknown size", "many messages", "a large number", "nothing"],
)
def test_a_chunk_that_unpacks_to_too_much_is_skipped(path: Path, chunk: Chunk) -> None:
    write_chunks(path, *[chunk] * 20)
    tracemalloc.start()
    losses = ReadLosses()
    count = len(contents(path, losses))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert count == 4, "those of the beginning"
    assert losses.places == 20
    assert peak < MAX_UNPACKED_BYTES


@pytest.mark.parametrize("compression", list(CompressionType))
def test_large_chunks_of_other_writers_are_read(path: Path, compression: CompressionType) -> None:
    """`mcap compress` and `mcap merge` make them, of the very same messages again and again at rest."""
    state = next(report for topic, report, _ in reports(1) if topic == keys.STATE)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4 * 2**20, compression=compression)
        writer.start()
        channel = writer.register_channel(keys.STATE, "json", writer.register_schema("State", "jsonschema", b"{}"))
        for number in range(5000):
            data = json.dumps({**state, "uptime_s": number / 10, "time": f"2026-11-22T00:00:{number / 100:09.6f}Z"})
            writer.add_message(channel, number, data.encode(), number)
        writer.finish()
    losses = ReadLosses()
    assert sum(1 for _ in read(path, losses)) == 5000
    assert not losses


@pytest.mark.parametrize("depth", [150, 1_000, 100_000])
@pytest.mark.parametrize(
    "made", [lambda depth: "[" * depth + "]" * depth, lambda depth: '{"a":' * depth + "1" + "}" * depth]
)
def test_lists_within_lists_are_no_traceback(path: Path, depth: int, made: Callable[[int], str]) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel(keys.FRAME, "json", 0)
        for text in (f'{{"bytes": {made(depth)}}}', "{}"):
            writer.add_message(channel, 0, text.encode(), 0)
        writer.finish()
    assert sum(1 for _ in read(path)) == (2 if depth < 200 else 1)


def test_a_file_of_nothing_but_beginnings_takes_no_longer_than_its_size(path: Path) -> None:
    """Each byte could be where the next chunk begins."""
    with Recording(path, time_ns=START_NS):
        pass
    chunk = RecordBuilder()
    a_chunk("zstd", b"x", 2**40, zlib.crc32(b"x")).write(chunk)
    data = path.read_bytes()
    path.write_bytes(data[: places(data)[-1].end] + (chunk.end()[:-1] + b"\xff") * 50_000)
    losses = ReadLosses()
    assert len(contents(path, losses)) == 4
    assert losses.places


def test_of_one_that_has_no_message_left_no_piece_is_made(path: Path, ride: bytes) -> None:
    path.write_bytes(ride[: len(MCAP_MAGIC) + 30] + b"\xff" * 1000)
    with pytest.raises(ConfigError, match="no message in it can be read"):
        cut(path, path.with_name("whole.mcap"), from_s=0, to_s=1e9)
    assert list(path.parent.iterdir()) == [path]


def test_wherever_a_file_is_cut_off_it_is_not_damaged(path: Path) -> None:
    recorded(path, 300).close()
    ride = path.read_bytes()
    last = places(ride)[-1]
    for end in (*range(last.begin - 20, last.begin + 60), *range(last.end - 2, last.end + 20)):
        path.write_bytes(ride[:end])
        losses = ReadLosses()
        for _ in read(path, losses, topics=()):
            pass
        assert not losses.places, end


def test_nobody_waits_for_the_other_end_of_a_named_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "ride.mcap"
    os.mkfifo(pipe)
    with pytest.raises(ConfigError, match=r"cannot be read \(it is a named pipe\)"):
        next(records(pipe))
