"""What is in a recording: whose it is, when, how many messages of what; and a piece of it as a file of its own."""

import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, Header, Message, Metadata

from gateway.errors import ConfigError
from gateway.people.recordings.pieces import ReadLosses
from gateway.people.recordings.reading import records
from gateway.people.recordings.writing import METADATA, Copy, making


class Contents(NamedTuple):
    """What a look through the whole file finds. Times are seconds since 1970."""

    recorded_with: str
    begin_s: float
    end_s: float
    messages: dict[str, int]
    """Channel → how many."""
    about: dict[str, Any]
    """Versions and settings, where the file has them."""
    losses: ReadLosses

    def as_json(self) -> dict[str, Any]:
        """The same as `lines`, for programs."""
        return {
            "recorded_with": self.recorded_with,
            "begin": _time(self.begin_s).isoformat(),
            "duration_s": round(self.end_s - self.begin_s, 3),
            "messages": self.messages,
            "about": self.about,
            "damaged_places": self.losses.places,
            "missing": self.losses.missing,
            "cut_off": self.losses.cut_off,
        }

    def lines(self) -> list[str]:
        """A summary in lines for people."""
        found = [
            f"{_time(self.begin_s):%Y-%m-%d %H:%M:%S} UTC, {self.end_s - self.begin_s:.1f} s, {self.recorded_with}",
            *(f"{count:>9}  {topic}" for topic, count in sorted(self.messages.items())),
            *(f"{name}: {json.dumps(value, ensure_ascii=False)}" for name, value in self.about.items()),
        ]
        if self.losses:
            found.append(str(self.losses))
        if self.losses.cut_off:
            found.append(
                "It ends in the middle, or is being written; `recordings cut` or `mcap recover` makes it a whole file"
            )
        return found


def contents(path: Path) -> Contents:
    """Raises ConfigError where it is no MCAP file or cannot be read."""
    losses, library = ReadLosses(), ""
    topics: dict[int, str] = {}
    messages: dict[str, int] = {}
    about: dict[str, Any] = {}
    begin_ns, end_ns = 2**64, 0
    for record in records(path, losses):
        if isinstance(record, Header):
            library = record.library
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message) and record.channel_id in topics:
            topic = topics[record.channel_id]
            messages[topic] = messages.get(topic, 0) + 1
            begin_ns, end_ns = min(begin_ns, record.log_time), max(end_ns, record.log_time)
        elif isinstance(record, Metadata) and record.name == METADATA:
            about = {name: _value(text) for name, text in record.metadata.items()}
    if not messages:
        damaged = losses or losses.cut_off
        raise ConfigError(f"{path}: {'no message in it can be read' if damaged else 'has no message'}")
    return Contents(library, begin_ns / 1e9, end_ns / 1e9, messages, about, losses)


def cut(path: Path, into: Path, *, from_s: float, to_s: float) -> int:
    """Write what was recorded from one second to another (counted from its first message) to a file of its own.

    What holds for all of it (the robot's description, the calibration in force) is taken along. Returns the number of
    messages. Raises ConfigError.
    """
    whole = contents(path)
    from_ns, to_ns = round((whole.begin_s + from_s) * 1e9), round((whole.begin_s + to_s) * 1e9)
    count = 0
    numbers: Counter[int] = Counter()
    standing: dict[str, Message] = {}
    with making(into), into.open("xb") as file:
        copy = Copy(file)
        for message in copy.messages(records(path)):
            topic = copy.topics[message.channel_id]
            if message.log_time < from_ns and topic in _STANDING:
                standing[topic] = message
            elif from_ns <= message.log_time <= to_ns:
                for each, time_ns in (*((each, from_ns) for each in standing.values()), (message, message.log_time)):
                    numbers[each.channel_id] += 1
                    copy.add(each, time_ns, numbers[each.channel_id])
                standing.clear()
                count += 1
        copy.finish()
        if not count:
            lasts_s = whole.end_s - whole.begin_s
            raise ConfigError(f"{path}: lasts {lasts_s:.1f} s, and has no message in that piece of it")
    return count


_STANDING = ("/robot_description", "hexapod/calibration")
"""The last of each holds until there is another."""


def _time(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
