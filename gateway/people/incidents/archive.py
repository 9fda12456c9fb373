"""The folder of incidents: one MCAP file each, written whole or not at all, the newest ones kept.

Which is the newest stands in a file of its own, `order`: a Raspberry Pi has no clock that goes on while it is off, so
what happened later may have an earlier time, in its name and as its file's time.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from pydantic import BaseModel, TypeAdapter

from gateway import durable
from gateway.model.black_box import format as form
from gateway.people.incidents.incidents import Incident, is_id
from gateway.people.incidents.messages import COMMAND_TOPICS, RECORDER, CommandInBox, FrameInBox, Note, messages
from gateway.people.incidents.ring_reader import Records
from gateway.people.incidents.story import headline
from gateway.people.recordings import REPORTS, RecordedMessage, Recording
from gateway.people.recordings.plain_schema import Schema, plain_schema
from schemas.calibration import Calibration
from schemas.keys import CALIBRATION, EVENT, FRAME, TELEMETRY
from schemas.telemetry import Event, Telemetry

MAX_FILES: Final = 100
_MAX_BYTES: Final = 200_000_000
SUFFIX: Final = ".mcap"
_ORDER: Final = "order"
"""A line for each incident, oldest first: its id, whether its file was written after the incident's end, and what
happened."""
_MAX_LINE: Final = 300
_MAX_ORDER_BYTES: Final = 64 * 1024
_OVER, _OPEN = "over", "open"


_CHANNELS: Final[dict[str, type[BaseModel]]] = {
    **dict.fromkeys(COMMAND_TOPICS, CommandInBox),
    RECORDER: Note,
    FRAME: FrameInBox,
    CALIBRATION: Calibration,
}


@cache
def _schema(model: type[BaseModel]) -> Schema:
    return plain_schema(TypeAdapter(model), model.__name__)


class KeptIncident(NamedTuple):
    """An incident that was kept as a file."""

    name: str
    path: Path
    size: int


def kept(folder: Path) -> list[KeptIncident]:
    """The incidents in a folder, in the order in which they happened."""
    found = []
    with suppress(OSError):
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            if is_id(path.stem):
                with suppress(OSError):
                    found.append(KeptIncident(path.stem, path, path.stat().st_size))
    places = {name: place for place, name in enumerate(_order(folder), 1)}
    return sorted(found, key=lambda each: places.get(each.name, 0))  # of an earlier version: before all, by their time


def path_of(folder: Path, incident: Incident) -> Path:
    """Where an incident's file is, or would be."""
    return folder / f"{incident.name}{SUFFIX}"


def write(path: Path, incident: Incident, records: Records) -> str:
    """Write an incident to a file; returns its headline. Raises OSError, FileExistsError."""
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
        return headline(_written(messages(incident, records), recording))


def _written(those: Iterator[RecordedMessage], recording: Recording) -> Iterator[RecordedMessage]:
    undeclared = dict(_CHANNELS)
    for message in those:
        if model := undeclared.pop(message.topic, None):  # viewers list a channel even if it is empty
            recording.declare(message.topic, model.__name__, _schema(model))
        if message.topic in REPORTS:
            recording.add_report(message.topic, message.content, message.time_ns)
        else:
            recording.add(message.topic, message.content, message.time_ns)
        yield message


def keep(folder: Path, incident: Incident, records: Records, later: Sequence[str] = (), *, over: bool = True) -> Path:
    """Write an incident into the folder; it is there whole, or as it was. Raises OSError.

    `later`: the ids of those that happened after it; `over`: whether all its time is over.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = path_of(folder, incident)
    with durable.replacing(path) as staged:
        staged.unlink(missing_ok=True)
        said = write(staged, incident, records)
        durable.sync(staged)
    _note(folder, incident.name, later, f"{_OVER if over else _OPEN} {said}"[:_MAX_LINE])
    return path


def is_kept(folder: Path, incident: Incident) -> bool:
    """Whether its file is there, and was written after its end: one that was written before lacks something."""
    try:
        written_ns = path_of(folder, incident).stat().st_mtime_ns
    except OSError:
        return False
    noted = _order(folder).get(incident.name)
    if noted is not None:
        return not incident.whole or noted.startswith(_OVER)
    return not incident.whole or written_ns > incident.end_ns + incident.wall_offset_ns


def prune(folder: Path) -> None:
    """Remove what is more than the newest MAX_FILES, or than MAX_BYTES. Raises OSError."""
    files, size = 0, 0
    for each in reversed(kept(folder)):
        files, size = files + 1, size + each.size
        if files > MAX_FILES or size > _MAX_BYTES:
            each.path.unlink()


def headlines(folder: Path) -> dict[str, str]:
    """What happened in each incident of a folder, by its id; those of an earlier version have none."""
    found = {name: state.partition(" ")[2] for name, state in _order(folder).items()}
    return {name: said for name, said in found.items() if said}


def _order(folder: Path) -> dict[str, str]:
    """The ids of incidents in the order in which they happened, and of each whether it was over when it was written."""
    try:
        with (folder / _ORDER).open(encoding="utf-8", errors="replace") as file:
            lines = file.read(_MAX_ORDER_BYTES).splitlines()
    except OSError:
        return {}
    found = (line.partition(" ") for line in lines)
    return {name: state for name, _, state in found if is_id(name)}


def _note(folder: Path, incident: str, later: Sequence[str], state: str) -> None:
    """Note an incident's place: where it was, else before the first of `later`, else at the end. Raises OSError."""
    order = [(name, was) for name, was in _order(folder).items() if (folder / f"{name}{SUFFIX}").exists()]
    names = [name for name, _ in order]
    if incident in names:
        place = names.index(incident)
        del order[place]
    else:
        place = next((place for place, name in enumerate(names) if name in later), len(names))
    order.insert(place, (incident, state))
    durable.write(folder / _ORDER, "".join(" ".join(line) + "\n" for line in order).encode())
