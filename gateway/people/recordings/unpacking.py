"""What one piece of a recording contains: a record, or a chunk with its records. Here are the limits for hostile files.

mcap's own reader reserves whatever a chunk says that it unpacks to: 98 kB took 3.2 GB.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema

MAX_RECORD_BYTES: Final = 16 * 2**20
"""What is written here has 16 KiB, and what other writers make of it 4 MiB. A length beyond this is damage."""
MAX_UNPACKED_BYTES: Final = 16 * 2**20
"""Of a chunk, which is unpacked in memory …"""
MAX_RATIO: Final = 1000
"""… and at most so many times as large as it is packed, so that the file's size bounds the time that reading takes.
States of a robot at rest, in chunks of 4 MiB, reach 440; nothing but zeros 30 000."""
FREE_BYTES: Final = 64 * 1024
"""A chunk of this size may have any ratio."""

RECORD_HEAD: Final = struct.Struct("<BQ")
"""Before each record: its type and its length."""
_MESSAGE: Final = struct.Struct("<HIQQ")
_CHECKSUM: Final = struct.Struct("<I")
_READERS: Final[dict[int, Callable[[ReadDataStream], McapRecord]]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
}


class DamagedError(ValueError):
    """Bytes that are no record."""


def unpack(opcode: int, body: bytes) -> Iterator[McapRecord]:
    """What a piece of a file contains: of a chunk its records, of an index nothing. Raises DamagedError."""
    if opcode == Opcode.MESSAGE:
        yield _message(body)
    elif opcode in _READERS:
        record = _read(_READERS[opcode], body)
        if isinstance(record, Chunk):
            yield from _within(_content(record))
            return
        if isinstance(record, Attachment):
            _check(body[-_CHECKSUM.size :], body[: -_CHECKSUM.size])
        yield record


def _content(chunk: Chunk) -> bytes:
    """A chunk unpacked, if it is neither damaged nor beyond the limits."""
    size = chunk.uncompressed_size
    if size > min(MAX_UNPACKED_BYTES, max(FREE_BYTES, MAX_RATIO * len(chunk.data))):
        raise DamagedError(f"a chunk of {len(chunk.data)} bytes states that it unpacks to {size}")
    try:
        data = _unpacked(chunk.compression, chunk.data, size)
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:  # lz4 has no errors of its own
        raise DamagedError("a chunk cannot be unpacked") from error
    if len(data) != size:
        raise DamagedError("a chunk does not unpack to what it states")
    _check(_CHECKSUM.pack(chunk.uncompressed_crc), data)
    return data


def _unpacked(compression: str, data: bytes, size: int) -> bytes:
    match compression:
        case "":
            return data
        case "zstd":
            # Memory is reserved for what the frame states, which may be other than what the chunk states.
            stated = zstandard.get_frame_parameters(data).content_size
            if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                raise DamagedError("a chunk contradicts itself")
            return zstandard.ZstdDecompressor().decompress(data, max_output_size=size) if size else b""
        case "lz4":
            unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
            return unpacked
        case _:
            raise DamagedError(f"a chunk is packed with {compression[:20]!r}")


def _within(data: bytes) -> Iterator[McapRecord]:
    """The records of an unpacked chunk. Messages are nearly all of them, and are read without mcap's steps."""
    at = 0
    while at < len(data):
        if at + RECORD_HEAD.size > len(data):
            raise DamagedError("a chunk ends within a record")
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        at += RECORD_HEAD.size
        if at + length > len(data):
            raise DamagedError("a chunk ends within a record")
        if opcode == Opcode.MESSAGE:
            yield _message(data[at : at + length])
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield _read(_READERS[opcode], data[at : at + length])
        at += length


def _message(body: bytes) -> Message:
    if len(body) < _MESSAGE.size:
        raise DamagedError("a message is cut off")
    channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(body)
    return Message(channel, log_ns, body[_MESSAGE.size :], publish_ns, sequence)


class _Exact(ReadDataStream):
    """mcap's own takes what is there where less is there than a length states."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def _read(read: Callable[[ReadDataStream], McapRecord], body: bytes) -> McapRecord:
    stream = _Exact(BytesIO(body))
    try:
        record = read(stream)
    except (EndOfFile, ValueError, OverflowError) as error:
        raise DamagedError("a record contradicts itself") from error
    if stream.count != len(body):
        raise DamagedError("a record is longer than what it says")
    return record


def _check(checksum: bytes, data: bytes) -> None:
    """Raises DamagedError for a wrong checksum. Zero: there is none."""
    if checksum != b"\0\0\0\0" and checksum != _CHECKSUM.pack(zlib.crc32(data)):
        raise DamagedError("a wrong checksum")
