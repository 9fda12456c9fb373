"""gateway.toml: the wire and the framing that the controller needs. Only a person can find them out.

After a wrong framing the published STM32 firmware receives nothing until its reset, not even a Stop. So `setup` asks
before anything is sent.
"""

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import gateway
from gateway.errors import ConfigError
from gateway.files import nesting
from gateway.host.settings_table import ControllerSettings, WireSettings
from gateway.model.frames import Framing
from gateway.model.protocols import SpiProtocol
from gateway.onboard.setup.machine import ETC, SERVICE, Machine
from gateway.people.terminal import say

FILE: Final = f"{ETC}/gateway.toml"
_SHIPPED: Final = Path(gateway.__file__).parent / "deploy"
_WIRE, _FRAMING = "wire.name", "spi.framing"
_DEFAULT: Final = WireSettings().name
_WIRES: Final = {each: each.words for each in SpiProtocol}
_FRAMINGS: Final = {
    Framing.LENGTH_PREFIXED: "the published STM32 firmware (after a plain frame, only a reset makes it receive again)",
    Framing.PLAIN: "a controller written to the protocol document",
}


class Configuration(NamedTuple):
    """gateway.toml: its text and its parsed tables."""

    text: str
    tables: Mapping[str, Any]

    def get(self, table: str, name: str, default: str = "") -> str:
        """Return a value as text; `default` if it is not set. Raises ConfigError if [table] is no table."""
        found = self.tables.get(table, {})
        if not isinstance(found, dict):
            raise ConfigError(f"{FILE}: [{table}] is no table; fix it there")
        return str(found.get(name, default))

    @property
    def uart(self) -> str | None:
        """The controller's UART; None if the wire has none."""
        wire = WireSettings(self.get("wire", "name", _DEFAULT))
        return self.get("controller", "uart", ControllerSettings().uart) if wire.has_uart else None


def shipped(name: str) -> bytes:
    """Return a file that this release ships in deploy/. Raises ConfigError."""
    try:
        return (_SHIPPED / name).read_bytes()
    except OSError as error:
        fix = f"install it anew: sudo apt install --reinstall {SERVICE}"
        raise ConfigError(f"{_SHIPPED / name}: {error.strerror}; {fix}") from error


def read(machine: Machine) -> Configuration:
    """Return the robot's configuration; the template if there is none. Raises ConfigError."""
    data = machine.read(FILE) or shipped("gateway.toml")
    try:
        tables = nesting.read_toml(data)
    except ValueError as error:
        raise ConfigError(f"{FILE} {error}; fix it there, or begin anew: sudo mv {FILE} {FILE}.bad") from error
    return Configuration(data.decode("utf-8-sig"), tables)


def state_wire(machine: Machine, wire: str | None, framing: str | None) -> Configuration:
    """Set wire and framing in the file; ask for them if neither is known. Return it. Raises ConfigError."""
    found = read(machine)
    stated = {_WIRE: found.get("wire", "name"), _FRAMING: found.get("spi", "framing")}
    if wire is None and framing is None and not any(stated.values()):
        wire = _ask("wire", _WIRES)
    wanted = {_WIRE: wire or stated[_WIRE] or _DEFAULT}
    if WireSettings(wanted[_WIRE]).framed:
        wanted[_FRAMING] = framing or stated[_FRAMING] or _ask("framing", _FRAMINGS)
        if not (wire or stated[_WIRE]):
            del wanted[_WIRE]  # the default
    elif framing is not None:
        raise ConfigError(f"--framing is for {_DEFAULT}; leave it out with {wanted[_WIRE]}")
    for setting, value in wanted.items():
        if value == stated[setting]:
            say(f'{FILE} states {setting} = "{value}"')
    return write(machine, found, {setting: value for setting, value in wanted.items() if value != stated[setting]})


def write(machine: Machine, found: Configuration, changes: Mapping[str, str]) -> Configuration:
    """Set these values (by dotted name) in the file; the rest stays. Return the result. Raises ConfigError."""
    text = found.text
    for setting, value in changes.items():
        table, _, name = setting.partition(".")
        text = with_value(text, table, name, value)
    new = "made from the template, " if machine.read(FILE) is None else ""
    stated = " and ".join(f'{setting} = "{value}"' for setting, value in changes.items())
    if changes:
        machine.put(FILE, text.encode(), f"write {FILE}: {new}with {stated}")
    return Configuration(text, nesting.read_toml(text.encode()))


def _ask(what: str, choices: Mapping[Any, str]) -> str:
    """Ask at the terminal. Raises ConfigError if nobody is there."""
    names, answer = " or ".join(map(str, choices)), ""
    if not sys.stdin.isatty():
        each = "; ".join(f"{name} ({meaning})" for name, meaning in choices.items())
        raise ConfigError(f"which {what} does the controller need? Use --{what} {names}: {each}")
    say(f"Which {what} does the controller need?")
    for name, meaning in choices.items():
        say(f"  {name:<16} {meaning}")
    while answer not in choices:
        try:
            answer = input(f"{names}? ").strip()
        except EOFError:
            raise ConfigError(f"nobody answered: use --{what}") from None
    return answer


def with_value(text: str, table: str, name: str, value: str) -> str:
    """Return the text with `table.name = value`, in place of the old value, of its comment, or as a new line.

    Of the places where it could stand, take the first that changes nothing else. Raises ConfigError if none does.
    """
    said, old = f"{name} = {json.dumps(value)}", rf"""{name}\s*=\s*(?:"[^"\n]*"|'[^'\n]*')"""
    edits = (
        (rf"^(\s*){old}", said),
        (rf"^(\s*){table}\.{old}", f"{table}.{said}"),
        (rf"^()# *{name} *=.*$", said),
        (rf"^(\s*\[\s*{table}\s*\].*)$", f"\n{said}"),
        (r"()\Z", f"\n[{table}]\n{said}\n"),
        (r"\A()", f"{table}.{said}\n"),
    )
    for pattern, new in edits:
        for found in re.finditer(pattern, text, re.MULTILINE):
            changed = f"{text[: found.end(1)]}{new}{text[found.end() :]}"
            if _differs_by_this_alone(text, changed, table, name, value):
                return changed
    raise ConfigError(f"{FILE} sets {table}.{name} in a way that a person must change; it needs {said} in [{table}]")


def _differs_by_this_alone(before: str, after: str, table: str, name: str, value: str) -> bool:
    wanted: dict[str, Any] = nesting.read_toml(before.encode())
    wanted.setdefault(table, {})[name] = value
    try:
        return nesting.read_toml(after.encode()) == wanted
    except ValueError:
        return False
