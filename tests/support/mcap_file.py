"""A recording as mcap's own reader has it, each message held against the schema that the file carries."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from mcap.reader import make_reader

from gateway.people.recordings import RecordedMessage
from gateway.people.recordings.drawing import DRAWN
from tests.support.ros2_bytes import decode

_SUFFIX = ".schema.json"


def checked(path: Path) -> Iterator[tuple[str, Any]]:
    """Of each message its topic, and its JSON or its ROS 2 message."""
    with path.open("rb") as file:
        attached = {each.name: each.data for each in make_reader(file).iter_attachments()}
        validators = {
            name.removesuffix(_SUFFIX): Draft202012Validator(json.loads(data))
            for name, data in attached.items()
            if name.endswith(_SUFFIX)
        }
        file.seek(0)
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if (kind := DRAWN.get(channel.topic)) is not None:
                assert schema is not None
                assert (schema.name, schema.encoding, channel.message_encoding) == (kind.TYPE, "ros2msg", "cdr")
                yield channel.topic, decode(kind, message.data)
            else:
                assert channel.message_encoding == "json"
                content = json.loads(message.data)
                validators[channel.topic].validate(content)
                yield channel.topic, content


def read(path: Path) -> Iterator[RecordedMessage]:
    """The JSON messages, in the file's order."""
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.message_encoding == "json":
                yield RecordedMessage(channel.topic, json.loads(message.data), message.log_time, message.publish_time)


def about(path: Path) -> dict[str, Any]:
    """What the file says of its gateway."""
    with path.open("rb") as file:
        found = {each.name: each.metadata for each in make_reader(file).iter_metadata()}
    return {name: json.loads(value) for name, value in found.get("hexapod-gateway", {}).items()}
