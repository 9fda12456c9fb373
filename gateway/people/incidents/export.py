"""One incident as an MCAP file: what the same tools read as a recording. A robot needs no extra for it.

What viewers draw is in it where the extra `record` is installed.
"""

import json
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

from mcap.writer import Writer

from gateway import __version__
from gateway.errors import ConfigError
from gateway.geometry import load
from gateway.people.incidents.find import Incident
from gateway.people.incidents.messages import messages
from gateway.people.incidents.ring_reader import Records
from gateway.people.recorder.drawing import INSTALLED, Drawing, definition, encode
from gateway.people.ros2.messages import Message


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that does not exist yet, and remove it if the `with` fails. Raises ConfigError."""
    try:
        with path.open("xb") as file, ExitStack() as failed:
            failed.callback(path.unlink, missing_ok=True)  # half of it is of no use, and its name would be taken
            yield file
            file.flush()
            failed.pop_all()
    except FileExistsError as error:
        raise ConfigError(f"{path} exists; name another file") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror})") from error


def write(path: Path, incident: Incident, records: Records) -> None:
    """Write an incident to a new file. Raises ConfigError if it exists or cannot be written."""
    with new_file(path) as file:
        _write(file, incident, records)


def _write(file: BinaryIO, incident: Incident, records: Records) -> None:
    writer = Writer(file)
    writer.start(profile="ros2", library=f"hexapod-gateway {__version__}")
    channels: dict[str, int] = {}

    def add(topic: str, data: bytes, time_ns: int, kind: type[Message] | None = None) -> None:
        if topic not in channels:
            # JSON has no schema here: rosbags 0.11 opens no file that has one.
            schema = writer.register_schema(kind.TYPE, "ros2msg", definition(kind).encode()) if kind else 0
            channels[topic] = writer.register_channel(topic, "cdr" if kind else "json", schema)
        writer.add_message(channels[topic], time_ns, data, time_ns)

    def draw(drawn: Iterable[tuple[str, Message]], time_ns: int) -> None:
        for topic, message in drawn if INSTALLED else ():
            add(topic, encode(message), time_ns, type(message))

    if about := records.about_at(incident.zero_ns):
        writer.add_metadata("hexapod-gateway", {name: json.dumps(value) for name, value in about.items()})
    drawing, begin_ns = Drawing(load()), incident.wall_ns(incident.begin_ns)
    draw((drawing.description(), *drawing.picture(begin_ns)), begin_ns)
    for message in messages(incident, records):
        add(message.topic, json.dumps(message.content, ensure_ascii=False).encode(), message.time_ns)
        draw(drawing.take(message.topic, message.content, message.time_ns), message.time_ns)
    writer.finish()
