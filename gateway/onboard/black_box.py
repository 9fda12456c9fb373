"""`hexapod-gateway incidents`: list, explain and export the incidents in the black box."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import typer

from gateway.errors import ConfigError, GatewayError
from gateway.model.black_box import RING_FILE
from gateway.onboard.replay import as_test, change_of, journal_of, play, seconds, supervisor_of, told
from gateway.people.incidents import ring_reader
from gateway.people.incidents.find import Incident, find, time_of
from gateway.people.incidents.messages import messages, new_file, write_file
from gateway.people.incidents.ring_reader import Records
from gateway.people.incidents.story import headline, story
from gateway.people.terminal import hint, say
from gateway.robot.blackbox import ring as rings
from gateway.robot.settings import Settings
from gateway.words.own_command import this_command

LAST: Final = "last"


def list_all(settings: Settings, *, as_json: bool = False) -> None:
    """Print the incidents, newest first. Raises ConfigError."""
    with _forged(settings):
        records = _read(settings)
        rows = [
            {"id": each.name, "time": time_of(each.name).isoformat(), "what": headline(messages(each, records))}
            for each in reversed(find(records))
        ]
    if as_json:
        typer.echo(json.dumps(rows, indent=1))
        return
    for row in rows:
        say(f"{row['id']:<32}  {row['time'][:19].replace('T', ' ')} UTC  {row['what']}")
    if not rows:
        say(f"No incidents in {_folder(settings)}.")


def show(settings: Settings, name: str, *, as_json: bool = False) -> None:
    """Print the story of the incident `name` (an id, or `last`).

    Raises GatewayError without it, and ConfigError if the black box is off or unreadable.
    """
    with _forged(settings):
        incident, records = _one(settings, name)
        lines = story(list(messages(incident, records)))
    if as_json:
        typer.echo(json.dumps({"id": incident.name, "story": lines}, indent=1, ensure_ascii=False))
        return
    for line in lines:
        say(line)


def export(settings: Settings, name: str, file: Path) -> None:
    """Write the incident `name` to the MCAP file `file`.

    Raises as `show` does, and ConfigError if `file` exists or cannot be written.
    """
    with _forged(settings):
        incident, records = _one(settings, name)
        write_file(file, incident, records)
    say(f"{incident.name} is in {file}")


def replay(
    settings: Settings,
    name: str,
    *,
    until: str | None = None,
    changes: Sequence[str] = (),
    file: Path | None = None,
    as_json: bool = False,
) -> bool:
    """Decide the incident `name` again, and print what decided. Return whether the frames are those written.

    `until`: seconds after the incident; `changes`: other settings, as NAME=VALUE; `file`: a new test. Raises as `show`
    does, and ConfigError if not all of it can be played.
    """
    with _forged(settings):
        incident, records = _one(settings, name)
        title = f"{incident.name}: {headline(messages(incident, records))}"
        until_ns = incident.end_ns if until is None else incident.zero_ns + seconds(until)
        change = change_of(records.about_at(incident.zero_ns), changes)
        journal = journal_of(records, incident, until_ns)
        played = play(journal, incident.zero_ns, change)
    if as_json:
        rows = [line._asdict() for line in played.lines]
        found = {"id": incident.name, "same": played.same, "frames": played.frames, "result": played.result}
        typer.echo(json.dumps({**found, "problem": played.problem, "timeline": rows}, indent=1, ensure_ascii=False))
    else:
        for text in (title, *told(played.lines), played.result):
            say(text)
    if file is not None:
        with new_file(file) as opened:
            opened.write(as_test(incident, title, supervisor_of(journal, change), played.decided).encode())
        hint(f"{incident.name} is in {file}")
    if played.problem:
        raise ConfigError(f"{incident.name} is not played to its end: {played.problem}")
    return played.same


@contextmanager
def _forged(settings: Settings) -> Iterator[None]:
    """Turn what reading a forged record raises into a ConfigError."""
    try:
        yield
    except ring_reader.FORGED as error:
        where = f"{_folder(settings) / RING_FILE}: a record is not what this gateway writes"
        raise ConfigError(f"{where} ({type(error).__name__}: {error}); the black box may be forged") from error


def _folder(settings: Settings) -> Path:
    folder = rings.folder_to_read(settings)
    if folder is None:
        raise ConfigError(
            "the black box is off: no gateway has kept one on this machine. `make run` and the installed service keep "
            "one; for a gateway that you start yourself, type:\n"
            f"mkdir -p ~/hexapod && HEXAPOD_STATE__PATH=$HOME/hexapod {this_command()} run --sim\n"
            "and HEXAPOD_STATE__PATH=$HOME/hexapod before `incidents`"
        )
    return folder


def _read(settings: Settings) -> Records:
    """Return all records, none without a ring. Raises ConfigError if the black box is off or cannot be read."""
    try:
        return ring_reader.read(_folder(settings) / RING_FILE)
    except ring_reader.NoRingError as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return Records({}, written=False)
        sudo = "; only the gateway's own user may read its black box, or root: sudo"
        raise ConfigError(f"{error}{sudo if isinstance(error.__cause__, PermissionError) else ''}") from error


def _one(settings: Settings, name: str) -> tuple[Incident, Records]:
    """Return the incident with this id, the newest for `last`, and all records. Raises GatewayError."""
    records = _read(settings)
    incidents = find(records)
    for found in reversed(incidents):
        if name in (LAST, found.name):
            return found, records
    if not incidents:
        raise GatewayError(f"there are no incidents in {_folder(settings)}")
    raise GatewayError(f"there is no incident {name!r} in {_folder(settings)}: `incidents list` shows all")
