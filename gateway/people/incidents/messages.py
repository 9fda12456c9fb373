"""An incident's records as messages of a recording: on the channels of our keys, in the time that people read.

They can be written as an MCAP file, which the same tools read as a recording. A robot needs no extra for it; what
viewers draw is in it where the extra `record` is installed.
"""

import json
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from heapq import merge
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Final, NamedTuple

from mcap.writer import Writer
from pydantic import AwareDatetime, Field

from gateway import __version__
from gateway.errors import ConfigError
from gateway.geometry import load
from gateway.model import black_box as form
from gateway.model.elkapod import Measured
from gateway.model.frames import Op
from gateway.model.telemetry import report_of
from gateway.people.incidents import ring_reader as rec
from gateway.people.incidents.find import Incident, killed
from gateway.people.recorder.drawing import INSTALLED, Drawing, definition, encode
from gateway.people.ros2.messages import Message
from schemas import keys
from schemas.calibration import Calibration
from schemas.event import Event, FrameRecord
from schemas.report import Report

RECORDER: Final = f"{keys.ROOT}/recorder"
"""The channel of notes, which no key of the gateway carries."""
INCIDENT: Final = "incident"


class RecordedMessage(NamedTuple):
    """A message of the gateway: its key, its parsed JSON, and when it was recorded (ns since 1970)."""

    topic: str
    content: dict[str, Any]
    time_ns: int


class TargetInBox(Report):
    """The part of a command for one servo."""

    id: int
    op: str
    angle_deg: float | None = None


class CommandInBox(Report):
    """A command as the gateway decoded it, and the verdict."""

    time: Annotated[AwareDatetime, Field(description="its arrival")]
    number: int
    verb: str
    source: str | None
    sent_ms: float | None
    targets: tuple[TargetInBox, ...]
    verdict: Annotated[str | None, Field(description="accepted, coalesced, or the reason of its rejection")]
    decided_ms: Annotated[float | None, Field(description="from its arrival to that")]


class FrameInBox(FrameRecord):
    """A FrameRecord with the black box's further fields."""

    transfer_us: float
    late_us: Annotated[float | None, Field(description="of a watchdog's Stop: written this long after its deadline")]


class Note(Report):
    """The incident, and what happened to the gateway itself.

    `what` is incident, start, end, killed, stop-servos, mode, lag, left_out (how many records of
    a source), or rejected (of a message that is no command).
    """

    time: AwareDatetime
    what: str
    detail: str
    source: str | None = None
    key: str | None = None


def messages(incident: Incident, records: rec.Records) -> Iterator[RecordedMessage]:
    """Return a note of the incident and the messages within its time, oldest first.

    What became of a command is found before its message is made. So each record is decoded twice rather than kept.
    """
    times_ns = records.times_ns
    taken = array("L", (index for index, ns in enumerate(times_ns) if incident.begin_ns <= ns <= incident.end_ns))
    before = [_noted(incident.wall_ns(incident.zero_ns), INCIDENT, incident.name)]
    for index in taken:
        if records.kinds[index] == form.START:
            before += _stops_before(records[index], incident)
    by_time = attrgetter("time_ns")
    return merge(sorted(before, key=by_time), _reported(incident, records, taken), key=by_time)


def _reported(incident: Incident, records: rec.Records, taken: Sequence[int]) -> Iterator[RecordedMessage]:
    decided_at = _decided(records, taken)
    calibration = records.calibration_at(incident.begin_ns)
    if calibration is not None:  # so that the frames can be read, which have the servos' own angles
        begin_ns = incident.wall_ns(incident.begin_ns)
        yield RecordedMessage(keys.CALIBRATION, calibration.model_dump(mode="json"), begin_ns)
    killed_ns = {place: ns for place, ns in killed(records).items() if incident.begin_ns <= ns <= incident.end_ns}
    for index in sorted(taken, key=records.times_ns.__getitem__):
        if index in killed_ns:
            yield _killed(incident.wall_ns(killed_ns.pop(index)))
        record = records[index]
        if isinstance(record.content, Calibration):
            if record.content == calibration:
                continue
            calibration = record.content
        decided = records[decided_at[index]] if index in decided_at else None
        yield from _messages(record, decided, incident.wall_ns(record.ns))
    for ns in killed_ns.values():
        yield _killed(incident.wall_ns(ns))


def _decided(records: rec.Records, taken: Iterable[int]) -> Mapping[int, int]:
    """Return the place of the step that ended a command, by the command's place."""
    found, waiting = dict[int, int](), dict[int, int]()
    for index in taken:
        content = records[index].content
        if isinstance(content, rec.CommandRecord):
            waiting[content.number] = index
        for number, _ in content.ended if isinstance(content, rec.CommandRecord | rec.StepRecord) else ():
            if number in waiting:
                found[waiting.pop(number)] = index
    return found


def _stops_before(start: rec.Record, incident: Incident) -> Iterator[RecordedMessage]:
    """Yield the Stops that `stop-servos` wrote between the end of the former gateway and this start."""
    facts = start.content.facts if isinstance(start.content, rec.Start) else {}
    match [facts.get(name) for name in form.STOP_FACTS]:
        case [int(first_ns), int(last_ns)] if incident.begin_ns <= first_ns <= last_ns <= start.ns:
            repeated = f"repeated for {(last_ns - first_ns) / 1e6:.0f} ms"
            yield _noted(incident.wall_ns(first_ns), "stop-servos", repeated)


def _killed(wall_ns: int) -> RecordedMessage:
    return _noted(wall_ns, "killed", "its last record; it ended without a word")


def _noted(wall_ns: int, what: str, detail: str) -> RecordedMessage:
    note = Note(time=_time(wall_ns), what=what, detail=detail)
    return RecordedMessage(RECORDER, note.model_dump(mode="json"), wall_ns)


def _messages(record: rec.Record, decided: rec.Record | None, wall_ns: int) -> Iterator[RecordedMessage]:
    """Yield the record's message, if it has one. `decided`: that of the step that ended a command."""
    time, topic, content = _time(wall_ns), RECORDER, record.content
    report: Report
    match content:
        case rec.CommandRecord(key=key):
            topic = key if key in keys.COMMAND_KEYS else RECORDER
            targets = tuple(
                TargetInBox(
                    id=servo, op=op.op.name.lower(), angle_deg=None if op.op is Op.STOP else op.angle_cdeg / 100
                )
                for servo, op in content.targets
            )
            verdict, decided_ns = _outcome(content.number, decided)
            decided_ms = None if decided_ns is None else (decided_ns - record.ns) / 1e6
            found = content._asdict() | {"targets": targets, "verdict": verdict, "decided_ms": decided_ms}
            report = CommandInBox(time=time, **found)
        case rec.FrameWritten(data, cause, transfer_ns, late_ns):
            topic = keys.FRAME
            report = FrameInBox(
                time=time,
                monotonic_ns=record.ns,
                bytes=data.hex(),
                cause=cause,
                transfer_us=transfer_ns / 1000,
                late_us=late_ns / 1000 if late_ns else None,
            )
        case Calibration():
            topic, report = keys.CALIBRATION, content
        case Measured():
            topic, report = keys.TELEMETRY, report_of(content, time, 0.0)
        case rec.EventPublished():
            topic, report = keys.EVENT, Event(time=time, **content._asdict())
        case rec.Start(facts=facts):
            detail = ", ".join(f"{name} {fact}" for name, fact in facts.items() if name not in form.STOP_FACTS)
            report = Note(time=time, what="start", detail=detail)
        case rec.Noted():
            report = Note(time=time, **content._asdict())
        case _:
            return
    yield RecordedMessage(topic, report.model_dump(mode="json"), wall_ns)


def _outcome(number: int, decided: rec.Record | None) -> tuple[str | None, int | None]:
    """Return the verdict on a command, and when its step began; None: unknown, or there was no step."""
    match decided:
        case rec.Record(_, ns, rec.CommandRecord(after_ns=after_ns, ended=ended)):
            return dict(ended)[number], None if after_ns == form.NO_STEP else ns + after_ns
        case rec.Record(_, ns, rec.StepRecord(ended=ended)):
            return dict(ended)[number], ns
    return None, None


def _time(wall_ns: int) -> datetime:
    return datetime.fromtimestamp(wall_ns / 1e9, UTC)


# ---- as a file


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


def write_file(path: Path, incident: Incident, records: rec.Records) -> None:
    """Write an incident to a new file. Raises ConfigError if it exists or cannot be written."""
    with new_file(path) as file:
        _write(file, incident, records)


def _write(file: BinaryIO, incident: Incident, records: rec.Records) -> None:
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
