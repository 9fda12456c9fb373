"""Reading a recording from its beginning: what was cut off has no index, and what is damaged is skipped and counted."""

from collections.abc import Container, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, Header, McapRecord
from mcap.records import Message as McapMessage
from pydantic_core import from_json

from gateway.errors import ConfigError
from gateway.people.recordings.pieces import MCAP_MAGIC, ReadLosses, opened, pieces

LIBRARY_NAME = "hexapod-gateway"
"""How a file's header names this program, which numbers the messages of a channel without gaps."""


class RecordedMessage(NamedTuple):
    """One message: its channel's name, its JSON, when it was recorded and (by the gateway's clock) published."""

    topic: str
    content: dict[str, Any]
    time_ns: int
    publish_ns: int


def records(path: Path, losses: ReadLosses | None = None) -> Iterator[McapRecord]:
    """All records that can be read; what cannot is counted in `losses`.

    Raises ConfigError where the file is no MCAP file or cannot be read.
    """
    losses = ReadLosses() if losses is None else losses
    newest: dict[int, int] = {}  # of each channel the number of its last message
    numbered = False
    try:
        with opened(path) as file:
            if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise ConfigError(f"{path}: is no MCAP file")
            for record in pieces(file, losses):
                if isinstance(record, Header):
                    numbered = record.library.startswith(LIBRARY_NAME)
                elif numbered and isinstance(record, McapMessage):
                    number = record.sequence
                    losses.missing += max(0, number - newest.get(record.channel_id, 0) - 1)
                    newest[record.channel_id] = number
                yield record
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error


def read(
    path: Path, losses: ReadLosses | None = None, topics: Container[str] | None = None
) -> Iterator[RecordedMessage]:
    """The JSON messages of a recording, in the file's order, also of one that was cut off or is damaged.

    `topics`: those of these channels only. Raises ConfigError.
    """
    wanted: dict[int, str] = {}
    for record in records(path, losses):
        if isinstance(record, McapMessage):
            topic = wanted.get(record.channel_id)
            if topic is None:
                continue
            try:
                content = from_json(record.data)  # unlike json's, it has an end to lists within lists
            except ValueError:
                continue
            if isinstance(content, dict):
                yield RecordedMessage(topic, content, record.log_time, record.publish_time)
        elif (
            isinstance(record, Channel)
            and record.message_encoding == "json"
            and (topics is None or record.topic in topics)
        ):
            wanted[record.id] = record.topic
