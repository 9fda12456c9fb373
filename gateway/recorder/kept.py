"""The folder of incidents: one MCAP file each, written whole or not at all, the newest ones kept."""

import os
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

from pydantic import BaseModel, TypeAdapter

from gateway.recorder.incidents import Incident, is_id
from gateway.recorder.messages import COMMAND_TOPICS, RECORDER, CommandInBox, FrameInBox, Note, messages
from gateway.recorder.reader import Records
from gateway.recordings import REPORTS, Recording
from gateway.recordings.plain_schema import Schema, plain_schema
from schemas.calibration import Calibration
from schemas.keys import CALIBRATION, EVENT, FRAME
from schemas.telemetry import Event

MAX_FILES: Final = 100
MAX_BYTES: Final = 200_000_000
SUFFIX: Final = ".mcap"
_UNFINISHED: Final = ".new"


_CHANNELS: Final[dict[str, type[BaseModel]]] = {
    **dict.fromkeys(COMMAND_TOPICS, CommandInBox),
    RECORDER: Note,
    FRAME: FrameInBox,
    CALIBRATION: Calibration,
}


@cache
def _schema(model: type[BaseModel]) -> Schema:
    return plain_schema(TypeAdapter(model), model.__name__)


class Kept(NamedTuple):
    """An incident's file."""

    name: str
    path: Path
    size: int


def kept(folder: Path) -> list[Kept]:
    """The incidents in a folder, oldest first."""
    found = []
    with suppress(OSError):
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            if is_id(path.stem):
                with suppress(OSError):
                    found.append(Kept(path.stem, path, path.stat().st_size))
    return found


def path_of(folder: Path, incident: Incident) -> Path:
    """Where an incident's file is, or would be."""
    return folder / f"{incident.name}{SUFFIX}"


def write(path: Path, incident: Incident, records: Records, *, overwrite: bool) -> None:
    """Write an incident to a file. Raises OSError; FileExistsError unless `overwrite`."""
    begin_ns = incident.wall_ns(incident.begin_ns)
    with Recording(path, overwrite=overwrite, time_ns=begin_ns, reports={EVENT: Event}) as recording:
        undeclared = dict(_CHANNELS)
        for message in messages(incident, records):
            if model := undeclared.pop(message.topic, None):  # viewers list a channel even if it is empty
                recording.declare(message.topic, model.__name__, _schema(model))
            if message.topic in REPORTS:
                recording.add_report(message.topic, message.content, message.time_ns)
            else:
                recording.add(message.topic, message.content, message.time_ns)


def keep(folder: Path, incident: Incident, records: Records) -> Path:
    """Write an incident into the folder; it is there whole, or as it was. Raises OSError."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    path = path_of(folder, incident)
    unfinished = path.with_suffix(_UNFINISHED)
    unfinished.unlink(missing_ok=True)
    try:
        write(unfinished, incident, records, overwrite=False)
        _sync(unfinished)
        unfinished.replace(path)
        _sync(folder)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise
    return path


def is_kept(folder: Path, incident: Incident) -> bool:
    """Whether its file is there, and was written after its end: one that was written before lacks something."""
    try:
        written_ns = path_of(folder, incident).stat().st_mtime_ns
    except OSError:
        return False
    return not incident.whole or written_ns > incident.end_ns + incident.wall_offset_ns


def prune(folder: Path) -> None:
    """Remove what is more than the newest MAX_FILES, or than MAX_BYTES. Raises OSError."""
    files, size = 0, 0
    for each in reversed(kept(folder)):
        files, size = files + 1, size + each.size
        if files > MAX_FILES or size > MAX_BYTES:
            each.path.unlink()


def _sync(path: Path) -> None:
    fd = os.open(path, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
