"""What `hexapod-gateway incidents` does: what the black box kept, and the story of each."""

import json
import logging
import signal
import threading
import time
from pathlib import Path
from typing import Any, Final, NamedTuple

import typer

from gateway.errors import ConfigError, GatewayError
from gateway.model.black_box.files import INCIDENTS_FOLDER, RING_FILE
from gateway.people.incidents import archive, ring_reader
from gateway.people.incidents.incidents import Incident, find, is_id, time_of
from gateway.people.incidents.messages import RECORDER, incident_of, messages
from gateway.people.incidents.page import as_page
from gateway.people.incidents.story import NoStoryError, headline, story, what
from gateway.people.incidents.watcher import LOOK_S, IncidentWatcher
from gateway.people.recordings import ReadLosses, RecordedMessage, read
from gateway.people.recordings.writing import making
from gateway.people.terminal import hint, say, this_command
from gateway.robot.blackbox import paths
from gateway.robot.settings import Settings
from gateway.text import visible

LAST: Final = "last"


class _Found(NamedTuple):
    """An incident: its file, or what is in the ring (which may have more of it)."""

    name: str
    path: Path
    """Where its file is, or would be."""
    size: int | None = None
    """Of the file, in bytes."""
    ring: tuple[Incident, ring_reader.Records] | None = None


def list_all(settings: Settings, *, as_json: bool = False) -> int:
    """Print the incidents, newest first. Exit code 0, also where there are none."""
    folder = _folder(settings)
    found, said = _find(folder), archive.headlines(folder / INCIDENTS_FOLDER)
    rows: list[dict[str, Any]] = [
        {
            "id": each.name,
            "time": time_of(each.name).isoformat(),
            "bytes": each.size,
            "what": _headline(each, said),
        }
        for each in reversed(found)
    ]
    if as_json:
        typer.echo(json.dumps(rows, indent=1))
        return 0
    for row in rows:
        size = "in the ring" if row["bytes"] is None else f"{row['bytes'] / 1000:.0f} kB"
        say(f"{row['id']:<32}  {row['time'][:19].replace('T', ' ')} UTC  {size:>12}  {row['what']}")
    if not found:
        say(f"No incidents in {folder}.")
    return 0


def _headline(found: _Found, headlines: dict[str, str]) -> str:
    """What happened, in a line."""
    if found.ring is None:
        return visible(headlines.get(found.name) or what(found.name))
    try:
        return headline(messages(*found.ring))
    except (NoStoryError, KeyError, TypeError, AttributeError):
        return what(found.name)


def show(settings: Settings, name: str, *, as_json: bool = False) -> int:
    """Print the story of an incident, or of a file of one."""
    found = _one(settings, name)
    _, lines = _told(found)
    if as_json:
        typer.echo(json.dumps({"id": found.name, "story": lines}, indent=1, ensure_ascii=False))
        return 0
    for line in lines:
        say(line)
    return 0


def report(settings: Settings, name: str, file: Path) -> int:
    """Write one page with the story, the joints and the Stops."""
    found = _one(settings, name)
    reported, lines = _told(found)
    with making(file), file.open("x", encoding="utf-8") as page:
        page.write(as_page(found.name, reported, lines))
    say(f"{found.name} is in {file}")
    return 0


def _told(found: _Found) -> tuple[list[RecordedMessage], list[str]]:
    """What is in it, and its story."""
    losses = ReadLosses()
    if found.ring is not None:
        reported = list(messages(*found.ring))
    elif incident_of(read(found.path, losses, (RECORDER,))) is None:  # it may be a ride of hours
        raise ConfigError(f"{found.path}: has no incident in it{_lost(losses)}; `recordings info` shows what it has")
    else:
        losses = ReadLosses()
        reported = list(read(found.path, losses))
    try:
        lines = story(reported)
    except (NoStoryError, KeyError, TypeError, AttributeError) as error:  # of a later version, or changed by hand
        raise ConfigError(f"{found.path}: is no incident that this version can tell{_lost(losses)}") from error
    if losses:
        hint(f"{found.path}: {losses}; the story lacks them")
    return reported, lines


def _lost(losses: ReadLosses) -> str:
    return f" ({losses})" if losses else ""


def export(settings: Settings, name: str, file: Path) -> int:
    """Write an incident's MCAP file."""
    found = _one(settings, name)
    with making(file):
        if found.ring is not None:
            archive.write(file, *found.ring)
        else:
            with file.open("xb") as copy:
                copy.write(found.path.read_bytes())
    say(f"{found.name} is in {file}")
    return 0


def keep(settings: Settings, *, once: bool) -> int:
    """Keep incidents until SIGTERM; `once`: those that are in the ring now, also where more may still be added."""
    logging.basicConfig(level=settings.log.level.upper(), format="%(message)s")
    keeper = IncidentWatcher(_folder(settings))
    if once:
        keeper.keep_all()
        return 0
    ended = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    while not ended.wait(LOOK_S):
        keeper.look()
    keeper.keep(whole_only=False)  # nobody will look again if the machine goes down
    return 0


def _folder(settings: Settings) -> Path:
    folder = paths.folder_to_read(settings)
    if folder is None:
        raise ConfigError(
            "the black box is off: no gateway has kept one on this machine. `make run` and the installed service keep "
            "one; for a gateway that you start yourself, type:\n"
            f"mkdir -p ~/hexapod && HEXAPOD_STATE__PATH=$HOME/hexapod {this_command()} run --sim\n"
            "and HEXAPOD_STATE__PATH=$HOME/hexapod before `incidents`"
        )
    return folder


def _find(folder: Path) -> list[_Found]:
    """All incidents, oldest first: after a change of the clock, that is not the order of their ids."""
    found = {each.name: _Found(*each) for each in archive.kept(folder / INCIDENTS_FOLDER)}
    try:
        content = ring_reader.read(folder / RING_FILE)
    except ring_reader.NoRingError as error:
        if isinstance(error.__cause__, PermissionError):  # "no incidents" would not be true
            raise ConfigError(f"{error}; only the gateway's own user may read its black box, or root: sudo") from error
        if not isinstance(error.__cause__, FileNotFoundError):
            hint(f"hexapod-gateway: {error}")
        return list(found.values())
    for incident in find(content.records, written=content.written, now_ns=time.monotonic_ns()):
        before = found.pop(incident.name, None)  # what is in the ring is newer than what is there no more
        if before is None or not archive.is_kept(folder / INCIDENTS_FOLDER, incident):
            path, size = archive.path_of(folder / INCIDENTS_FOLDER, incident), None if before is None else before.size
            before = _Found(incident.name, path, size, (incident, content.records))
        found[incident.name] = before
    return list(found.values())


def _one(settings: Settings, name: str) -> _Found:
    """The incident of that id, or the one in a file that somebody was sent."""
    if name.endswith(archive.SUFFIX):
        return _Found(Path(name).stem, Path(name))
    folder = _folder(settings)
    found = _find(folder)
    if name == LAST and found:
        return found[-1]
    for each in found:
        if each.name == name:
            return each
    if name != LAST and not is_id(name):
        raise NoIncidentError(
            f"{name!r} is no id of an incident, and no file's name, which ends in .mcap; `incidents list` shows them, "
            "and `last` is the newest"
        )
    raise NoIncidentError(f"there is no incident {'' if name == LAST else name + ' '}in {folder}")


class NoIncidentError(GatewayError):
    """There is no such incident."""
