"""The pieces of a recording's file, one after the other, past those that are damaged.

mcap's own reader ends at the first damage. Here the next chunk is looked for: its beginning states its length twice.
"""

import errno
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from mcap.opcode import Opcode
from mcap.records import McapRecord

from gateway.people.recordings.unpacking import MAX_RECORD_BYTES, RECORD_HEAD, DamagedError, unpack

MCAP_MAGIC: Final = b"\x89MCAP0\r\n"
"""The first and the last bytes of a whole MCAP file."""

_CHUNK_HEAD: Final = struct.Struct("<QQQII")
_CHUNK_BYTES: Final = 40
"""Of a chunk, besides the name of its compression and its data."""
_CHUNK_NAMES: Final = (0, 3, 4)
"""How long that name is: none, lz4, zstd."""
_SIZE: Final = struct.Struct("<Q")
_INDEX_HEAD: Final = struct.Struct("<HI")
_FOOTER: Final = struct.Struct("<QQI")
_A_CHUNK: Final = re.compile(rb"(?=\x06.{4}\0{4}.{28}(?:\x04\0{3}zstd|\x03\0{3}lz4|\0{4}).{4}\0{4})", re.DOTALL)
_A_CHUNK_BYTES: Final = 64
"""More than what `_A_CHUNK` looks at."""
_FIRST_LOOK_BYTES, _LONGEST_LOOK_BYTES = 4096, 2**20
"""The next chunk is near the damage as a rule; where it is not, the steps grow."""

_ENDS: Final[dict[int, int]] = {Opcode.DATA_END: 4, Opcode.FOOTER: _FOOTER.size}
"""What the index begins with, and its length."""
_FRAMED: Final = (Opcode.CHUNK, Opcode.MESSAGE_INDEX)
"""Their length is right although their content is not: they state it twice."""
_TYPES: Final = frozenset(
    {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.METADATA, *_FRAMED, *_ENDS}
)
"""What stands before the index."""


def opened(path: Path) -> BinaryIO:
    """The file, to be read. Raises OSError, also for a named pipe, at which a reader would wait for ever."""
    if path.is_fifo():
        raise OSError(errno.EINVAL, "it is a named pipe", path)
    return path.open("rb")


@dataclass(slots=True)
class ReadLosses:
    """What could not be read of a recording, counted while it is read."""

    places: int = 0
    """Damaged places that were skipped."""
    first_at: int = 0
    """The first of them, in bytes from the file's beginning."""
    first_why: str = ""
    missing: int = 0
    """Messages that were there once, as the numbers of the others tell; also in a piece that was cut."""
    cut_off: bool = False
    """Whether the file ends within a record."""

    def __bool__(self) -> bool:
        """Whether more is lost than the end, which a writer that was killed had not written yet."""
        return bool(self.places or self.missing)

    def __str__(self) -> str:
        """Such as: 2 damaged places were skipped (the first at byte 12: a wrong checksum); 35 messages are missing."""
        parts = []
        if self.places:
            places = "1 damaged place was" if self.places == 1 else f"{self.places} damaged places were"
            first = f"at byte {self.first_at}: {self.first_why}"
            parts.append(f"{places} skipped ({first if self.places == 1 else f'the first {first}'})")
        if self.missing:
            parts.append("1 message is missing" if self.missing == 1 else f"{self.missing} messages are missing")
        return "; ".join(parts)

    def skip(self, at: int, why: str) -> None:
        """Count a damaged place that was skipped."""
        if not self.places:
            self.first_at, self.first_why = at, why
        self.places += 1


def pieces(file: BinaryIO, losses: ReadLosses) -> Iterator[McapRecord]:
    """All records before the file's index that can be read, also those within chunks. Raises OSError.

    The index repeats what chunks declare. It is read where one is damaged.
    """
    found = _RecordFile(file)
    at = len(MCAP_MAGIC)
    while True:
        following: int | None = None
        try:
            opcode, length = found.head(at)
            if opcode in _ENDS:
                return
            if opcode in _FRAMED:
                following = at + RECORD_HEAD.size + length
            yield from unpack(opcode, found.body(at, length))
            at += RECORD_HEAD.size + length
            continue
        except _CutOffError as error:
            following = found.next_chunk(at + 1)
            if following is None:
                losses.cut_off = True
                return
            why = str(error)
        except DamagedError as error:
            following = following or found.next_chunk(at + 1)
            why = str(error)
        losses.skip(at, why)
        yield from found.declared_again()
        if following is None:
            return
        at = following


class _CutOffError(DamagedError):
    """The file ends within a record that is as it should be until there."""


class _RecordFile:
    """A file of records that follow one another."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._size = file.seek(0, os.SEEK_END)

    def head(self, at: int) -> tuple[int, int]:
        """The type and the length of the record that begins there. Raises DamagedError where none can."""
        head = self._read(at, RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            raise _CutOffError("the file ends")
        opcode, length = RECORD_HEAD.unpack(head)
        if not _can_begin(opcode, length):
            raise DamagedError("no record begins there")
        end = at + RECORD_HEAD.size + length
        if self._is_chunk(at + RECORD_HEAD.size, length) is (opcode != Opcode.CHUNK):
            raise DamagedError("a chunk contradicts itself")
        if opcode == Opcode.MESSAGE_INDEX:
            self._check_index(at + RECORD_HEAD.size, length)
        if opcode == Opcode.MESSAGE and end < self._size and not self._goes_on(end):
            raise DamagedError("no record follows it")
        if end > self._size:
            raise _CutOffError("the file ends within a record")
        return opcode, length

    def body(self, at: int, length: int) -> bytes:
        """What the record that begins there has behind its head."""
        return self._read(at + RECORD_HEAD.size, length)

    def next_chunk(self, at: int) -> int | None:
        """Where the next chunk begins that is all there; its checksum is not looked at."""
        look_bytes = _FIRST_LOOK_BYTES
        while at < self._size:
            for found in _A_CHUNK.finditer(self._read(at, look_bytes + _A_CHUNK_BYTES)):
                try:
                    self.head(at + found.start())
                except DamagedError:
                    continue
                return at + found.start()
            at += look_bytes
            look_bytes = min(2 * look_bytes, _LONGEST_LOOK_BYTES)
        return None

    def declared_again(self) -> Iterator[McapRecord]:
        """The schemas and channels in the index of a whole file, as far as they can be read."""
        magic_at = self._size - len(MCAP_MAGIC)
        footer_at = magic_at - RECORD_HEAD.size - _FOOTER.size
        if footer_at < len(MCAP_MAGIC) or self._read(magic_at, len(MCAP_MAGIC)) != MCAP_MAGIC:
            return
        at, _, _ = _FOOTER.unpack(self._read(footer_at + RECORD_HEAD.size, _FOOTER.size))
        while len(MCAP_MAGIC) < at < footer_at:
            opcode, length = RECORD_HEAD.unpack(self._read(at, RECORD_HEAD.size))
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or length > MAX_RECORD_BYTES:
                return
            try:
                yield from unpack(opcode, self.body(at, length))
            except DamagedError:
                return
            at += RECORD_HEAD.size + length

    def _is_chunk(self, at: int, length: int) -> bool | None:
        """Whether it states its length twice, as a chunk does; None: the file ends before that."""
        head = self._read(at, _CHUNK_HEAD.size)
        name_bytes = _CHUNK_HEAD.unpack(head)[-1] if len(head) == _CHUNK_HEAD.size else 0
        if name_bytes not in _CHUNK_NAMES:
            return False
        size = self._read(at + _CHUNK_HEAD.size + name_bytes, _SIZE.size)
        if len(size) < _SIZE.size:
            return None
        return bool(length == _CHUNK_BYTES + name_bytes + _SIZE.unpack(size)[0])

    def _check_index(self, at: int, length: int) -> None:
        head = self._read(at, _INDEX_HEAD.size)
        if len(head) == _INDEX_HEAD.size and length != _INDEX_HEAD.size + _INDEX_HEAD.unpack(head)[1]:
            raise DamagedError("an index contradicts itself")

    def _goes_on(self, at: int) -> bool:
        head = self._read(at, RECORD_HEAD.size)
        return len(head) < RECORD_HEAD.size or _can_begin(*RECORD_HEAD.unpack(head))

    def _read(self, at: int, length: int) -> bytes:
        self._file.seek(at)
        return self._file.read(length)


def _can_begin(opcode: int, length: int) -> bool:
    return opcode in _TYPES and length <= MAX_RECORD_BYTES and length == _ENDS.get(opcode, length)
