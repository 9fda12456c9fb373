"""Reading a recording from its beginning, as far as it goes: what was cut off has no index, and needs none here."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from mcap.records import Channel, McapRecord
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader

from gateway.errors import ConfigError

MAX_RECORD_BYTES: Final = 64 * 2**20
"""Far above what is written here. A length beyond it is damage, and nobody should reserve memory for it."""


class Message(NamedTuple):
    """One message: its channel's name, its JSON, when it was recorded and (by the gateway's clock) published."""

    topic: str
    content: dict[str, Any]
    time_ns: int
    publish_ns: int


def records(path: Path) -> Iterator[McapRecord]:
    """All records before the first damage. Raises ConfigError where the file is no MCAP file or cannot be read."""
    try:
        with path.open("rb") as file:
            found = StreamReader(file, record_size_limit=MAX_RECORD_BYTES, validate_crcs=True).records
            record = _next(found, path)
            while record is not None:
                yield record
                record = _next(found)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error


def _next(found: Iterator[McapRecord], path: Path | None = None) -> McapRecord | None:
    """The next record; None where the file ends or is damaged. Of `path`, the first must be there."""
    try:
        return next(found)
    except OSError:
        raise
    except Exception as error:  # mcap, zstandard and lz4 each have their own ways to say that bytes make no sense
        if path is not None:
            raise ConfigError(f"{path}: is no MCAP file") from error
        return None


def read(path: Path) -> Iterator[Message]:
    """All JSON messages of a recording, in the file's order, also of one that was cut off. Raises ConfigError."""
    topics: dict[int, str] = {}
    for record in records(path):
        match record:
            case Channel(message_encoding="json"):
                topics[record.id] = record.topic
            case McapMessage() if record.channel_id in topics:
                try:
                    content = json.loads(record.data)
                except ValueError:
                    continue
                if isinstance(content, dict):
                    yield Message(topics[record.channel_id], content, record.log_time, record.publish_time)
