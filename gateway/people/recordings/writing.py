"""Writing a recording (MCAP, profile `ros2`): the gateway's reports as JSON, and what viewers draw as ROS 2's messages.

A chunk is handed to the kernel at once, and ends after half a second: so much a killed writer loses at most.
"""

import json
import os
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, McapRecord
from mcap.records import Schema as McapSchema
from mcap.writer import CompressionType, Writer
from pydantic import BaseModel, TypeAdapter

from gateway import __version__
from gateway.geometry import Geometry, load, urdf
from gateway.people.recordings.drawing import DRAWN, DRAWN_FROM, Drawing
from gateway.people.recordings.locking import locked
from gateway.people.recordings.plain_schema import Schema, plain_schema, without_nulls
from gateway.people.recordings.reading import LIBRARY_NAME
from gateway.people.ros2.cdr import Message, encode
from gateway.people.ros2.definition import definition
from schemas.calibration import Calibration
from schemas.keys import CALIBRATION, EVENT, FRAME, SIM_BODY, STATE
from schemas.telemetry import BodyReport, Event, FrameRecord, GatewayState

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
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
        self._writer.start(profile=PROFILE, library=LIBRARY)
        self._channels: dict[str, int] = {}
        self._counts: dict[int, int] = {}
        self._begun_ns = self._flushed_ns = time_ns
        self._declared: list[McapRecord] = []
        self._drawing = Drawing(geometry)
        self._writer.add_attachment(time_ns, time_ns, URDF_NAME, "application/xml", urdf(geometry).encode())
        for topic, kind in DRAWN.items():
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def bytes_written(self) -> int:
        """The size of the file."""
        return self._file.tell()

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
        for topic, message in drawn:
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
        """Close the file as it is: the disk does not take the rest. `repair` makes it whole."""
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


class _Unbuffered:
    """A file as mcap's writer needs it. What was written is the kernel's at once: it stays when this process dies."""

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0)
        self._fd = os.open(path, flags if overwrite else flags | os.O_EXCL, 0o644)
        try:
            locked(self._fd)  # so that nobody repairs what is being written
            os.ftruncate(self._fd, 0)
        except BaseException:
            os.close(self._fd)
            raise
        self._size = 0
        self.closed = False

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            written = os.write(self._fd, rest)
            self._size += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        return self._size

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            os.close(self._fd)
