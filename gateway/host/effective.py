"""The settings that the service uses: its file and its unit's variables, as they were at its start.

`stop-servos` and `check` read these, since the file may be edited later, and a shell lacks the variables of a drop-in:
bare frames make a controller deaf that expects announced ones. The service writes its settings and its process number
into its runtime directory before its first frame. They are current while that process runs, and for the commands that
systemd runs after its end. Later they remain for a `stop-servos` that finds no other settings.
"""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from gateway.files import durable, nesting
from gateway.host.directories import SERVICE_RUNTIME, runtime_directory
from gateway.host.settings_reader import ForStops, read_for_stops
from gateway.host.settings_table import FOR_STOPS

NAME: Final = "effective.json"
_INVOCATION: Final = "INVOCATION_ID"
"""systemd's id for one start of a unit, which the unit's commands after its end have, too."""


@dataclass(frozen=True)
class Effective(ForStops):
    """The settings that a service uses."""

    runs: bool
    """Whether the process that wrote this runs. Its number and begin are compared, since numbers are reused."""
    ended_here: bool
    """Whether systemd runs this command after the end of the service that wrote this."""


def write(used: ForStops) -> None:
    """Write the settings that this process uses. Raises OSError, ValueError.

    Without a runtime directory, or with a wrong section [power], nothing is written.
    """
    folder = runtime_directory()
    if folder is None or used.power is None:
        return
    process = {"process": os.getpid(), "begun": _begun(os.getpid()), "invocation": os.environ.get(_INVOCATION, "")}
    staged = folder / f".{NAME}.new"
    staged.write_text(json.dumps(process | _tables(used), indent=1, default=str), encoding="utf-8")
    staged.replace(folder / NAME)  # complete at any time; the folder is in memory, so no sync is needed


def read() -> Effective | None:
    """Return the settings that a service has written since the boot, or None if there are no usable ones.

    Never raises and never waits: a fault here must not prevent a Stop.
    """
    path = (runtime_directory() or SERVICE_RUNTIME) / NAME
    try:
        # O_NONBLOCK: the service's user may have put a FIFO there, for which root must not wait.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
        with open(descriptor, "rb") as file:
            data = file.read(nesting.MOST_BYTES + 1)
        nesting.check(data)
        tables = json.loads(data)
    except (OSError, ValueError):
        return None
    if not isinstance(tables, dict):
        return None
    found, faults = read_for_stops(tables)
    if faults or (found.wire.framed and "framing" not in tables.get("spi", {})):
        return None
    process, invocation = tables.get("process"), tables.get("invocation")
    runs = isinstance(process, int) and _begun(process) == tables.get("begun")
    ended_here = bool(invocation) and invocation == os.environ.get(_INVOCATION)
    return Effective(found.wire, found.spi, found.controller, found.power, runs, ended_here)


def running() -> Effective | None:
    """Return the settings of the service that runs on this machine; None if none runs, or they cannot be read."""
    used = read()
    return used if used is not None and used.runs else None


def differences(used: Effective, path: Path) -> list[str]:
    """Return a sentence for each difference between a file and the settings that the service uses."""
    try:
        data = durable.read(path, nesting.MOST_BYTES)
        stated = None if data is None else read_for_stops(nesting.read_toml(data))[0]
    except (OSError, ValueError):
        stated = None
    if stated is None:
        return [f"{path} cannot be read, and the service uses spi.framing = {_shown(used.spi.framing)}"]
    found = []
    for section, uses in _tables(used).items():
        states = _tables(stated)[section]
        for name in dict.fromkeys((*uses, *states)):
            ours, theirs = _shown(states.get(name)), _shown(uses.get(name))
            if ours != theirs:
                found.append(f"{path} has {section}.{name} = {ours}, and the service uses {theirs}")
    return found


def _tables(used: ForStops) -> dict[str, dict[str, Any]]:
    """Return the settings for Stops by section and name; None: the section [power] is wrong."""
    found = {
        section: {name: getattr(getattr(used, section), name, None) for name in names}
        for section, names in FOR_STOPS.items()
    }
    found["wire"] |= used.wire.options
    return found


def _shown(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, default=str)


def _begun(process: int) -> int | None:
    """Return when a process began, in the kernel's ticks since the boot, or None without such a process."""
    try:
        # The second field, a name in brackets, may contain anything; the begin is the 22nd.
        return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return None
