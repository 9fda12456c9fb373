"""Writing a recording (MCAP, profile `ros2`): the gateway's reports as JSON, and what viewers draw as ROS 2's messages.

A chunk is handed to the kernel at once, and ends after half a second: so much a killed writer loses at most.
"""

import json
import os
import sys
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from io import BufferedWriter, FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, Self

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Metadata
from mcap.records import Message as McapMessage
from mcap.records import Schema as McapSchema
from mcap.writer import CompressionType, Writer
from pydantic import BaseModel, TypeAdapter

from gateway import __version__
from gateway.errors import ConfigError
from gateway.geometry import Geometry, load, urdf
from gateway.people.recordings.drawing import DRAWN, DRAWN_FROM, Drawing
from gateway.people.recordings.plain_schema import Schema, plain_schema, without_nulls
from gateway.people.recordings.reading import LIBRARY_NAME
from gateway.people.ros2.cdr import INSTALLED, definition, encode
from gateway.people.ros2.messages import Message
from schemas.calibration import Calibration
from schemas.keys import CALIBRATION, EVENT, FRAME, SIM_BODY, STATE, TELEMETRY
from schemas.telemetry import BodyReport, Event, FrameRecord, GatewayState, Telemetry

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

if sys.platform != "win32":
    import fcntl

CHUNK_BYTES: Final = 1024 * 1024
"""The library's default; a robot that walks does not fill it before it is flushed."""
FLUSH_NS: Final = 500_000_000
"""A chunk is written after half a second all the same, once the next message comes."""
DECLARE_NS: Final = 60_000_000_000
"""The channels are declared again so often, in a chunk of 3 kB: without the one that declares them, nobody could read
any message of a file that was cut off."""
MAX_TIME_NS: Final = 2**64 - 1
"""The last one that MCAP can write, in the year 2554; the first is 1970."""
LIBRARY: Final = f"{LIBRARY_NAME} {__version__}"
PROFILE: Final = "ros2"
JSON_ENCODING: Final = "json"
SCHEMA_TYPE: Final = "application/schema+json"
ROS_ENCODING: Final = "cdr"
ROS_SCHEMA_ENCODING: Final = "ros2msg"
METADATA: Final = "hexapod-gateway"
URDF_NAME: Final = "robot.urdf"

REPORTS: Final[Mapping[str, type[BaseModel]]] = {
    STATE: GatewayState,
    EVENT: Event,
    FRAME: FrameRecord,
    CALIBRATION: Calibration,
    TELEMETRY: Telemetry,
    SIM_BODY: BodyReport,
}
"""The keys that are recorded, which are their channels' names, and what is published there."""


class Recording:
    """An MCAP file that grows: channels with their schemas, what viewers draw, a URDF, and whose recording it is.

    Times are nanoseconds since 1970. Raises OSError, also from `close`, where the disk does not take it.
    """

    def __init__(
        self,
        path: Path,
        geometry: Geometry | None = None,
        *,
        overwrite: bool = False,
        time_ns: int,
        reports: Mapping[str, type[BaseModel]] = REPORTS,
    ) -> None:
        """Begin the file, with a channel for each of `reports`. Raises FileExistsError unless `overwrite`."""
        geometry = geometry or load()
        self.path = path
        self._file = _Unbuffered(path, overwrite=overwrite)
        try:
            self._begin(geometry, time_ns, reports)
        except BaseException:  # a full disk: nobody has a use for a file with nothing in it
            self._file.close()
            path.unlink(missing_ok=True)
            raise

    def _begin(self, geometry: Geometry, time_ns: int, reports: Mapping[str, type[BaseModel]]) -> None:
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library=LIBRARY)
        self._channels: dict[str, int] = {}
        self._counts: dict[int, int] = {}
        self._begun_ns = self._flushed_ns = time_ns
        self._declared: list[McapRecord] = []
        self._drawing = Drawing(geometry)
        self._writer.add_attachment(time_ns, time_ns, URDF_NAME, "application/xml", urdf(geometry).encode())
        for topic, kind in DRAWN.items() if INSTALLED else ():
            if topic not in DRAWN_FROM or DRAWN_FROM[topic] in reports:  # viewers list channels that are empty
                self._declare_drawn(topic, kind)
        for topic, model in reports.items():
            self.declare(topic, model.__name__, plain_schema(TypeAdapter(model), model.__name__))
        self._declare_again(time_ns)
        self._draw((self._drawing.description(),), time_ns)
        self._draw(self._drawing.picture(time_ns), time_ns)
        self._writer.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def bytes_written(self) -> int:
        """The size of the file."""
        return self._file.size

    def declare(self, topic: str, name: str, schema: Schema) -> None:
        """A further channel of JSON messages; `plain_schema` makes a schema that viewers read.

        Raises ValueError where the topic has a channel: viewers show the count of its first.
        """
        if topic in self._channels:
            raise ValueError(f"{topic} has a channel already")
        # Attached, and not the channel's: rosbags 0.11 opens no file that has one, and viewers read JSON without.
        data = json.dumps({"title": name, **schema}).encode()
        self._writer.add_attachment(self._begun_ns, self._begun_ns, f"{topic}.schema.json", SCHEMA_TYPE, data)
        self._channel(topic, JSON_ENCODING, 0)

    def _declare_drawn(self, topic: str, kind: type[Message]) -> None:
        data = definition(kind).encode()
        schema_id = self._writer.register_schema(kind.TYPE, ROS_SCHEMA_ENCODING, data)
        self._declared.append(McapSchema(id=schema_id, name=kind.TYPE, encoding=ROS_SCHEMA_ENCODING, data=data))
        self._channel(topic, ROS_ENCODING, schema_id)

    def _channel(self, topic: str, encoding: str, schema_id: int) -> None:
        self._channels[topic] = number = self._writer.register_channel(topic, encoding, schema_id)
        self._declared.append(
            Channel(id=number, topic=topic, message_encoding=encoding, schema_id=schema_id, metadata={})
        )

    def describe(self, about: Mapping[str, Any]) -> None:
        """Note whose recording it is: versions and settings, by their names."""
        found = {**about, "recorded_with": LIBRARY}
        self._writer.add_metadata(METADATA, {name: json.dumps(value) for name, value in found.items()})

    def add_report(self, topic: str, report: Mapping[str, Any], time_ns: int) -> None:
        """Something that the gateway published on one of `REPORTS`, as its JSON, and what is drawn for it."""
        self.add(topic, report, time_ns, published_ns(report))
        self._draw(self._drawing.take(topic, report, time_ns), time_ns)

    def add(self, topic: str, message: Mapping[str, Any], time_ns: int, publish_ns: int | None = None) -> None:
        """A message of a channel of JSON; what is null in it is left out."""
        data = json.dumps(without_nulls(message), separators=(",", ":"), ensure_ascii=False).encode()
        self._add(topic, data, time_ns, time_ns if publish_ns is None else publish_ns)

    def _draw(self, drawn: Iterable[tuple[str, Message]], time_ns: int) -> None:
        for topic, message in drawn if INSTALLED else ():
            self._add(topic, encode(message), time_ns, time_ns)

    def _add(self, topic: str, data: bytes, time_ns: int, publish_ns: int) -> None:
        channel = self._channels[topic]
        self._counts[channel] = number = self._counts.get(channel, 0) + 1
        self._writer.add_message(channel, time_ns, data, publish_ns, number)
        if time_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = time_ns
            self._writer.flush()
            if time_ns - self._declared_ns >= DECLARE_NS:
                self._declare_again(time_ns)

    def close(self) -> None:
        """Write the index, so that readers find their way, and close the file."""
        if self._file.closed:
            return
        try:
            self._writer.finish()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close the file as it is: the disk does not take the rest."""
        self._file.close()

    def _declare_again(self, time_ns: int) -> None:
        """A chunk without messages, between two others. mcap's writer makes none, and asks the file where it is."""
        self._declared_ns = time_ns
        records, chunk = RecordBuilder(), RecordBuilder()
        for record in self._declared:
            record.write(records)
        data = records.end()
        Chunk("zstd", zstandard.compress(data), 0, 0, zlib.crc32(data), len(data)).write(chunk)
        self._file.write(chunk.end())


def about(state: GatewayState) -> dict[str, Any]:
    """Versions, and the settings that the state shows."""
    return state.model_dump(mode="json", include={"version", "protocol", "simulated", "spi", "watchdog", "limits"})


def published_ns(report: Mapping[str, Any]) -> int | None:
    """When the gateway said so, by its wall clock; None where it does not say, or no file can."""
    with suppress(KeyError, TypeError, ValueError, OverflowError):
        published = int(datetime.fromisoformat(report["time"]).timestamp() * 1_000_000) * 1000
        return published if 0 <= published <= MAX_TIME_NS else None
    return None


class _Unbuffered(BufferedWriter):
    """A file that holds nothing back: what was written is the kernel's at once, and stays when this process dies."""

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        """Begin the file, once nobody else writes it. Raises ConfigError, OSError."""
        flags = 0 if overwrite else os.O_EXCL
        file = FileIO(path, "wb", opener=lambda name, usual: os.open(name, usual & ~os.O_TRUNC | flags, 0o644))
        super().__init__(file)
        self.size = 0
        try:
            _lock(self.fileno())  # so that two programs never write one file
            self.truncate(0)
        except BaseException:
            self.close()
            raise

    def write(self, data: "ReadableBuffer", /) -> int:
        written = super().write(data)
        self.flush()
        self.size += written
        return written

    def close(self) -> None:
        """Without what the disk did not take."""
        self.raw.close()


def _lock(fd: int) -> None:
    """Who writes a file holds its lock, where the system has such locks; it ends with its process.

    Raises ConfigError where another program writes this file.
    """
    if sys.platform == "win32":
        return
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise ConfigError("another program is writing this file") from error
    except OSError:  # a file system without locks
        return


@contextmanager
def making(path: Path) -> Iterator[None]:
    """While a file is made that is not there yet: nothing is left of it where that fails. Raises ConfigError."""
    try:
        if os.path.lexists(path):
            raise FileExistsError
        yield
    except FileExistsError as error:
        raise ConfigError(f"{path} exists; name another file") from error
    except BaseException as error:
        with suppress(OSError):  # half of it is of no use, and its name would be taken
            path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise ConfigError(f"{path}: cannot be written ({error.strerror})") from error
        raise


class Copy:
    """A file with what is taken over from another one."""

    def __init__(self, file: BinaryIO) -> None:
        self._writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._schemas: dict[int, int] = {}
        self._channels: dict[int, int] = {}
        self.topics: dict[int, str] = {}
        """By the other file's channels."""

    def messages(self, records: Iterable[McapRecord]) -> Iterator[McapMessage]:
        """Take over the other file's records but for its messages, which are returned, for `add`."""
        for number, record in enumerate(records):
            if number == 0:
                header = record if isinstance(record, Header) else Header(profile="", library=LIBRARY)
                self._writer.start(profile=header.profile, library=header.library)
            if isinstance(record, McapMessage):
                if record.channel_id in self._channels:
                    yield record
            else:
                self._take(record)

    def _take(self, record: McapRecord) -> None:
        writer = self._writer
        match record:
            case McapSchema() if record.id not in self._schemas:
                self._schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            case Channel() if record.id not in self._channels:
                self.topics[record.id] = record.topic
                self._channels[record.id] = writer.register_channel(
                    record.topic, record.message_encoding, self._schemas.get(record.schema_id, 0), record.metadata
                )
            case Attachment():
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                writer.add_metadata(record.name, record.metadata)

    def add(self, message: McapMessage, time_ns: int, number: int) -> None:
        """Write one of these messages."""
        channel = self._channels[message.channel_id]
        self._writer.add_message(channel, time_ns, message.data, message.publish_time, number)

    def finish(self) -> None:
        """Write the index, without which most readers find nothing."""
        self._writer.finish()
