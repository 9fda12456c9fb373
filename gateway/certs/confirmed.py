"""Which list of revoked certificates each robot has confirmed, recorded in the CA's folder."""

import json
from pathlib import Path
from typing import Final

from pydantic import NonNegativeInt, TypeAdapter, ValidationError

from gateway.certs import folder
from gateway.certs.files import FileContent, read_file, replace
from gateway.errors import ConfigError

CONFIRMED_FILE: Final = "confirmed.json"
_NUMBERS: Final = TypeAdapter(dict[str, NonNegativeInt])


def numbers(directory: Path) -> dict[str, int]:
    """By robot, the number of the list that it has confirmed. Raises ConfigError."""
    path = directory / CONFIRMED_FILE
    if not path.exists():
        return {}
    try:
        return _NUMBERS.validate_json(read_file(path, "record of who has confirmed a list"))
    except ValidationError as error:
        raise ConfigError(f"{path} cannot be read: delete it, and bring the list again (certs revoke)") from error


def note(directory: Path, robot: str, number: int) -> None:
    """Record that `robot` has this list in force."""
    known = {**numbers(directory), robot: number}
    replace(directory / CONFIRMED_FILE, FileContent(f"{json.dumps(known, indent=1, sort_keys=True)}\n".encode()))


def shown(directory: Path) -> dict[str, str]:
    """For a table, by each robot's file name: `3`; `2, not 3`; `not 3`. Empty without a list."""
    newest = folder.revoked(directory)
    if newest is None or not (directory / "ca.key").exists():
        return {}
    known, stems = numbers(directory), folder.robots_of(directory) or ["gateway"]
    found = zip(stems, (known.get(robot) for robot in folder.robots(directory)), strict=True)
    return {
        stem: f"not {newest.number}" if number is None else _against(number, newest.number) for stem, number in found
    }


def _against(number: int, newest: int) -> str:
    return str(number) if number >= newest else f"{number}, not {newest}"
