"""Making a recording whole that was cut off: its writer was killed, or its computer lost its power."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from gateway.errors import ConfigError
from gateway.recordings.locking import in_use
from gateway.recordings.reading import records
from gateway.recordings.writing import CHUNK_BYTES, LIBRARY_NAME

MAGIC: Final = b"\x89MCAP0\r\n"
"""The first and the last bytes of a whole MCAP file."""


class Repaired(NamedTuple):
    """What a repair found: how many messages, and how many seconds from the first to the last."""

    messages: int
    seconds: float


def is_cut_off(path: Path) -> bool:
    """Whether this is the beginning of an MCAP file without its end, which nobody is writing. False if unreadable."""
    with suppress(OSError), path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC or in_use(file.fileno()):
            return False
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return size < 2 * len(MAGIC) or file.read() != MAGIC
    return False


def is_ours(path: Path) -> bool:
    """Whether this program began the file."""
    try:
        first = next(records(path))
    except ConfigError:
        return False
    return isinstance(first, Header) and first.library.startswith(LIBRARY_NAME)


def repair(path: Path) -> Repaired:
    """Put a whole file in the place of one that was cut off, with all that can be read of it.

    Raises ConfigError where there is nothing to be read, OSError where the disk does not take it; the file is then as
    it was.
    """
    partial = path.with_name(f".{path.name}.repair")
    try:
        with partial.open("wb") as file:
            found = _copy(path, Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD))
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    return found


def _copy(path: Path, writer: Writer) -> Repaired:
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    count, first_ns, last_ns = 0, 0, 0
    for record in records(path):
        match record:
            case Header():
                writer.start(profile=record.profile, library=record.library)
            case Schema() if record.id not in schemas:
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            case Channel() if record.id not in channels:
                schema = schemas.get(record.schema_id, 0)
                channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, schema, record.metadata
                )
            case Message() if record.channel_id in channels:
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
                first_ns = record.log_time if count == 0 else min(first_ns, record.log_time)
                last_ns = max(last_ns, record.log_time)
                count += 1
            case Attachment():
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                writer.add_metadata(record.name, record.metadata)
    if count == 0:
        raise ConfigError(f"{path}: was cut off before its first message; there is nothing in it, and it can go")
    writer.finish()
    return Repaired(count, (last_ns - first_ns) / 1e9)
