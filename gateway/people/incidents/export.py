"""One incident as an MCAP file: what the same tools read as a recording."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from pydantic import BaseModel, TypeAdapter

from gateway.model.black_box import format as form
from gateway.people.incidents.incidents import Incident
from gateway.people.incidents.messages import COMMAND_TOPICS, RECORDER, CommandInBox, FrameInBox, Note, messages
from gateway.people.incidents.ring_reader import Records
from gateway.people.recordings import REPORTS, RecordedMessage, Recording
from gateway.people.recordings.plain_schema import plain_schema
from schemas.calibration import Calibration
from schemas.keys import CALIBRATION, EVENT, FRAME, TELEMETRY
from schemas.telemetry import Event, Telemetry

_CHANNELS: Final[dict[str, type[BaseModel]]] = {
    **dict.fromkeys(COMMAND_TOPICS, CommandInBox),
    RECORDER: Note,
    FRAME: FrameInBox,
    CALIBRATION: Calibration,
}


def write(path: Path, incident: Incident, records: Records) -> None:
    """Write an incident to a new file. Raises OSError, FileExistsError."""
    begin_ns = incident.wall_ns(incident.begin_ns)
    reports: dict[str, type[BaseModel]] = {EVENT: Event}
    if any(
        kind == form.MEASURED and incident.begin_ns <= ns <= incident.end_ns
        for kind, ns in zip(records.kinds, records.times_ns, strict=True)
    ):
        reports[TELEMETRY] = Telemetry
    with Recording(path, time_ns=begin_ns, reports=reports) as recording:
        if about := records.about_at(incident.zero_ns):
            recording.describe(about)
        _add(messages(incident, records), recording)


def _add(those: Iterable[RecordedMessage], recording: Recording) -> None:
    undeclared = dict(_CHANNELS)
    for message in those:
        if model := undeclared.pop(message.topic, None):
            recording.declare(message.topic, model.__name__, plain_schema(TypeAdapter(model), model.__name__))
        if message.topic in REPORTS:
            recording.add_report(message.topic, message.content, message.time_ns)
        else:
            recording.add(message.topic, message.content, message.time_ns)
