"""Recordings as mcap's own reader has them; a black box's bytes as records; a disk that takes no more."""

import json
import resource
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from pydantic import BaseModel

from gateway.model import black_box as form
from gateway.people.incidents import ring_reader
from gateway.people.incidents.messages import RECORDER, CommandInBox, FrameInBox, Note, RecordedMessage
from gateway.people.recorder.drawing import DRAWN
from gateway.people.recorder.record import METADATA, REPORTS
from schemas.keys import COMMAND_KEYS
from tests.support.ros2_messages import decode

IN_A_BOX: Final[dict[str, type[BaseModel]]] = {**dict.fromkeys(COMMAND_KEYS, CommandInBox), RECORDER: Note}


def checked(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield each message's topic, and its JSON or its ROS 2 message."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if (kind := DRAWN.get(channel.topic)) is not None:
                assert schema is not None
                assert (schema.name, schema.encoding, channel.message_encoding) == (kind.TYPE, "ros2msg", "cdr")
                yield channel.topic, decode(kind, message.data)
            else:
                assert (schema, channel.message_encoding) == (None, "json")
                content = json.loads(message.data)
                model = FrameInBox if "transfer_us" in content else {**REPORTS, **IN_A_BOX}[channel.topic]
                model.model_validate(content)
                yield channel.topic, content


def read(path: Path) -> Iterator[RecordedMessage]:
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.message_encoding == "json":
                yield RecordedMessage(channel.topic, json.loads(message.data), message.log_time)


def whole(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the JSON messages of a file that was cut off, which has no index."""
    topics: dict[int, str] = {}
    with path.open("rb") as file, suppress(EndOfFile):
        for record in StreamReader(file).records:
            if isinstance(record, Channel) and record.message_encoding == "json":
                topics[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in topics:
                yield topics[record.channel_id], json.loads(record.data)


def about(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        found = {each.name: each.metadata for each in make_reader(file).iter_metadata()}
    return {name: json.loads(value) for name, value in found.get(METADATA, {}).items()}


def parse(data: bytes) -> ring_reader.Records:
    """Return the records, oldest first. Raises NoRingError."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "ring")
        path.write_bytes(data)
        return ring_reader.read(path)


def put(buffer: Any, offset: int, kind: int, sequence: int, ns: int, rest: bytes) -> None:
    """Write one slot, as `RecordRing.append` does."""
    body = form.pack_head(len(rest) + form.HEAD_BYTES, kind, 0, sequence, ns) + rest
    form.pack_slot_into(buffer, offset, zlib.crc32(body), body)


@contextmanager
def disk_that_takes(size: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
