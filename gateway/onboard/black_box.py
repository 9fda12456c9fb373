"""`hexapod-gateway incidents`: list, explain, export and replay the incidents in the black box."""

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


class BlackBox:
    """The black box that a gateway with these settings keeps on this machine.

    Each method raises ConfigError if the box cannot be read or may be forged, and GatewayError without the incident.
    """

    def __init__(self, settings: Settings) -> None:
        """Raises ConfigError if the black box is off."""
        folder = rings.folder_to_read(settings)
        if folder is None:
            raise ConfigError(
                "the black box is off: no gateway has kept one on this machine. `make run` and the installed service "
                "keep one; for a gateway that you start yourself, type:\n"
                f"mkdir -p ~/hexapod && HEXAPOD_STATE__PATH=$HOME/hexapod {this_command()} run --sim\n"
                "and HEXAPOD_STATE__PATH=$HOME/hexapod before `incidents`"
            )
        self._folder = folder

    def list_all(self, *, as_json: bool = False) -> None:
        """Print the incidents, newest first."""
        with self._forged():
            records = self._read()
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
            say(f"No incidents in {self._folder}.")

    def show(self, name: str, *, as_json: bool = False) -> None:
        """Print the story of the incident `name` (an id, or `last`)."""
        with self._forged():
            incident, records = self._one(name)
            lines = story(list(messages(incident, records)))
        if as_json:
            typer.echo(json.dumps({"id": incident.name, "story": lines}, indent=1, ensure_ascii=False))
            return
        for line in lines:
            say(line)

    def export(self, name: str, file: Path) -> None:
        """Write the incident `name` to the MCAP file `file`. Raises ConfigError if it exists or cannot be written."""
        with self._forged():
            incident, records = self._one(name)
            write_file(file, incident, records)
        say(f"{incident.name} is in {file}")

    def replay(
        self,
        name: str,
        *,
        until: str | None = None,
        changes: Sequence[str] = (),
        file: Path | None = None,
        as_json: bool = False,
    ) -> bool:
        """Decide the incident `name` again, and print what decided. Return whether the frames are those written.

        `until`: seconds after the incident; `changes`: other settings, as NAME=VALUE; `file`: a new test. Raises
        ConfigError if not all of it can be played.
        """
        with self._forged():
            incident, records = self._one(name)
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
    def _forged(self) -> Iterator[None]:
        """Turn what reading a forged record raises into a ConfigError."""
        try:
            yield
        except ring_reader.FORGED as error:
            where = f"{self._folder / RING_FILE}: a record is not what this gateway writes"
            raise ConfigError(f"{where} ({type(error).__name__}: {error}); the black box may be forged") from error

    def _read(self) -> Records:
        """Return all records, none without a ring. Raises ConfigError if they cannot be read."""
        try:
            return ring_reader.read(self._folder / RING_FILE)
        except ring_reader.NoRingError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return Records({}, written=False)
            sudo = "; only the gateway's own user may read its black box, or root: sudo"
            raise ConfigError(f"{error}{sudo if isinstance(error.__cause__, PermissionError) else ''}") from error

    def _one(self, name: str) -> tuple[Incident, Records]:
        """Return the incident with this id, the newest for `last`, and all records. Raises GatewayError."""
        records = self._read()
        incidents = find(records)
        for found in reversed(incidents):
            if name in (LAST, found.name):
                return found, records
        if not incidents:
            raise GatewayError(f"there are no incidents in {self._folder}")
        raise GatewayError(f"there is no incident {name!r} in {self._folder}: `incidents list` shows all")
