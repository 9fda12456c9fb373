"""The service's settings: frozen, checked, with units in their names. Each fault is one line that names its place.

They come from a TOML file; environment variables (`HEXAPOD_SPI__DEVICE`) override it. docs/interface.md lists them.
`stop-servos` reads its settings here, too, so nothing slow is imported.
"""

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self, get_origin

from gateway import nesting
from gateway.errors import ConfigError
from gateway.host.directories import CONFIGURATION
from gateway.host.settings_reader import (
    NO_SETTING,
    SERVOS,
    ForStops,
    Place,
    SettingFault,
    Text,
    dotted,
    read,
    read_for_stops,
)
from gateway.host.settings_table import (
    FOR_STOPS,
    START_STAGGER_MS,
    ButtonSettings,
    ControllerSettings,
    LeaseSettings,
    LimitSettings,
    PowerSettings,
    SafetySettings,
    ServoLimits,
    SpiSettings,
    StateSettings,
    TelemetrySettings,
    WatchdogSettings,
    WireSettings,
    ZenohSettings,
)
from gateway.model.frames import PROTOCOL_VERSION, STOP_REPEAT_MS, STOP_REPEATS
from gateway.model.framing import Framing
from gateway.own_command import CONNECT_VARIABLE
from gateway.text import echo, key_name

ENV_PREFIX: Final = "HEXAPOD_"


@dataclass(frozen=True)
class Settings:
    """All settings of one service."""

    zenoh: ZenohSettings = field(default_factory=ZenohSettings)
    wire: WireSettings = field(default_factory=WireSettings)
    spi: SpiSettings = field(default_factory=SpiSettings)
    controller: ControllerSettings = field(default_factory=ControllerSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    watchdog: WatchdogSettings = field(default_factory=WatchdogSettings)
    lease: LeaseSettings = field(default_factory=LeaseSettings)
    buttons: ButtonSettings = field(default_factory=ButtonSettings)
    state: StateSettings = field(default_factory=StateSettings)
    telemetry: TelemetrySettings = field(default_factory=TelemetrySettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    power: PowerSettings = field(default_factory=PowerSettings)

    @property
    def starts_whole(self) -> bool:
        """Whether only the whole robot can be started and stopped. A board whose supply starts servos starts each."""
        singly = self.wire.supply_starts and self.power.interface
        return self.wire.capabilities.whole_robot and not singly

    @property
    def measures(self) -> bool:
        """Whether the wire or a power board measures anything for telemetry."""
        return self.wire.capabilities.measures or bool(self.power.interface)

    @property
    def protocol(self) -> str:
        """The protocol that the gateway reports: HexapodProtocol with its version, or the wire's name."""
        return PROTOCOL_VERSION if self.wire.framed else self.wire.name

    @property
    def framing(self) -> str:
        """The framing that the gateway reports, or "none" if the wire has none."""
        return self.spi.framing if self.wire.framed else "none"

    @property
    def device(self) -> str:
        """The device to which frames are written, or a plug-in's name."""
        return self.wire.name if self.wire.built_in is None else self.spi.device

    def __post_init__(self) -> None:
        object.__setattr__(self, "spi", self.spi.of(self.wire))
        if self.limits.start_stagger_ms < 0:  # it is not set
            at_once = self.starts_whole or self.power.interface
            limits = replace(self.limits, start_stagger_ms=0.0 if at_once else START_STAGGER_MS)
            object.__setattr__(self, "limits", limits)

    @classmethod
    def of(cls, tables: Mapping[str, Any]) -> Self:
        """Return settings from a TOML file's tables. Raises ConfigError with one line for each fault."""
        faults: list[SettingFault] = []
        found = read(cls, tables, faults)
        faults = faults or list(found.faults())
        if faults:
            raise ConfigError("\n".join(f"{dotted(fault.place)}: {fault.sentence}" for fault in faults))
        return found

    def faults(self) -> Iterable[SettingFault]:
        """Yield the faults between settings that are valid alone but not together."""
        wire = self.wire.name
        if self.spi.too_fast:
            yield SettingFault(("spi",), self.spi.too_fast)
        if self.starts_whole and self.power.interface:
            yield SettingFault(("power", "interface"), f"{wire} starts all servos at once, which no power board does")
        if self.starts_whole and self.limits.start_stagger_ms:
            yield SettingFault(("limits", "start_stagger_ms"), f"{wire} starts all servos at once, so leave it at 0")
        if self.limits.start_stagger_ms >= self.watchdog.timeout_ms:
            sentence = f"a leg's start may not wait for as long as watchdog.timeout_ms, {self.watchdog.timeout_ms:g}"
            yield SettingFault(("limits", "start_stagger_ms"), sentence)
        # A plug-in has no way to pass measurements on, so a limit on them would never stop anything.
        measured = self.wire.built_in is not None and self.wire.capabilities.measures
        for each in fields(self.safety):
            if getattr(self.safety, each.name) and not measured:
                yield SettingFault(("safety", each.name), f"{wire} has nothing that measures it; leave it at 0")
        for servo, angle_deg in self.watchdog.landing.items():
            limits = self.limits.servos.get(servo, ServoLimits())
            if not limits.min_deg <= angle_deg <= limits.max_deg:
                allowed = f"limits.servos.{servo} allows {limits.min_deg:g} to {limits.max_deg:g}"
                yield SettingFault(("watchdog", "landing", servo), f"{angle_deg:g} is not allowed: {allowed}")


class FramingNotSetError(ConfigError):
    """spi.framing is not set. The text lists all other faults, too."""


Variables = Mapping[Place, tuple[str, Any]]
"""Environment variables and their values, by the setting that they set."""


def load(path: Path | None = None, *, simulated: bool = False) -> Settings:
    """Return the settings from `path` (None: the default file, if there is one) and the environment.

    Raises ConfigError with one line for each fault; the line names the file's entry or the variable. Unless the
    controller is `simulated`, spi.framing must be set: plain frames overrun the published firmware's buffer, after
    which no Stop reaches its servos until a reset.
    """
    lines: list[str] = []
    tables: dict[str, Any] = {}
    try:
        tables = _without_emptied(_read(path))
    except ConfigError as error:
        lines.append(str(error))
    unread = bool(lines)
    variables, misnamed = _environment()
    in_file, merged = _faults(tables), _merged(tables, variables)
    lines += [_line(path, fault) for fault in in_file]
    lines += [f"{key_name(variable)}: {fault.sentence}" for variable, fault in misnamed]
    lines += [_line(path, fault, variables) for fault in _faults(merged) if fault not in in_file]
    if not (simulated or unread):
        _require_framing(path, merged, lines)
    if lines:
        raise ConfigError("\n".join(lines))
    return read(Settings, merged, [])


def load_for_stops(path: Path | None = None) -> ForStops:
    """Return the settings that `stop-servos` needs. Raises ConfigError if [spi] or the UART is wrong.

    Everything else is ignored, even removed settings. `SpiSettings.within_limits` adds the framing's limits.
    """
    variables, misnamed = _environment()
    merged = _merged(_read(path), variables)
    found, faults = read_for_stops(merged)
    wrong = [(variable, fault) for variable, fault in misnamed if fault.place[0] == "spi"]
    lines = [f"{key_name(variable)}: {fault.sentence}" for variable, fault in wrong if not _harmless(fault)]
    lines += [_line(path, _said(fault), variables) for fault in faults if not _harmless(fault)]
    _require_framing(path, merged, lines)
    if lines:
        raise ConfigError("\n".join(lines))
    return found


def _faults(tables: Mapping[str, Any]) -> list[SettingFault]:
    faults: list[SettingFault] = []
    found = read(Settings, tables, faults)
    faults = faults or list(found.faults())
    return list(map(_said, faults))


def _said(fault: SettingFault) -> SettingFault:
    """Return the fault; if the setting was removed, its sentence names the replacement."""
    return fault._replace(sentence=_REMOVED.get(fault.place, NO_SETTING)) if fault.sentence == NO_SETTING else fault


def _harmless(fault: SettingFault) -> bool:
    """Return whether the fault is a removed setting that no Stop needs."""
    return fault.place in _REMOVED and fault.place != _PROTOCOL


def _line(path: Path | None, fault: SettingFault, variables: Variables = MappingProxyType({})) -> str:
    named = _variables_at(fault.place, variables)
    where = " and ".join(named) or f"{path or CONFIGURATION}: {dotted(fault.place)}"
    return f"{where}: {fault.sentence}"


_WHICH_FRAMING: Final = (
    'is not set (after any "plain" frame the published STM32 firmware needs a reset); without a controller: run --sim',
    *(f'{each.controller} needs "{each}"' for each in Framing),
)


def _require_framing(path: Path | None, tables: Mapping[str, Any], lines: list[str]) -> None:
    wire, spi = tables.get("wire", {}), tables.get("spi", {})
    framed = isinstance(wire, Mapping) and WireSettings(str(wire.get("name", WireSettings().name))).framed
    if framed and isinstance(spi, Mapping) and not {"framing", "protocol"} & spi.keys():
        lines += [f"{path or CONFIGURATION}: spi.framing: {sentence}" for sentence in _WHICH_FRAMING]
        raise FramingNotSetError("\n".join(lines))


def overrides(variables: Mapping[str, str]) -> dict[str, str]:
    """Return those of `variables` that override a file's settings for Stops."""
    prefixes = tuple(f"{ENV_PREFIX}{section.upper()}__" for section in FOR_STOPS)
    return {name: value for name, value in variables.items() if name.upper().startswith(prefixes)}


# ---- the file


def _read(path: Path | None) -> dict[str, Any]:
    found = path or CONFIGURATION
    try:
        with found.open("rb") as file:
            return nesting.read_toml(file.read(nesting.MOST_BYTES + 1))
    except FileNotFoundError:
        if path is None:
            return {}
        raise ConfigError(f"{found}: there is no such file; name another with --config") from None
    except OSError as error:
        raise ConfigError(f"{found}: cannot be read ({error.strerror}); name another file with --config") from error
    except ValueError as error:
        raise ConfigError(f"{found}: {error}") from error


_PROTOCOL: Final = ("spi", "protocol")
_IN_STATE: Final = "was removed; name its folder with state.path, the folder for all kept state"
_REMOVED: Final[Mapping[Place, str]] = {
    ("calibration",): f"{_IN_STATE} (the calibration as calibration.toml)",
    ("recorder",): f"{_IN_STATE} (the black box keeps 60 s)",
    _PROTOCOL: "was removed; write its value as name in [wire]",
    ("spi", "batch"): "was removed; lists of transfers are written, and single ones where the kernel takes no lists",
    ("spi", "resync_ms"): "was removed; length-prefixed framing synchronises a stream once a second",
    ("spi", "avoid_deg"): "was removed; it follows from the framing",
    ("controller", "cycle_hz"): "was removed; the controller's cycle is 50 Hz",
    ("lease", "takeover"): "was removed; everybody may take the lease, which stops all legs first",
    ("telemetry", "state_hz"): "was removed; the state is published ten times a second",
    ("telemetry", "rate_hz"): "was removed; telemetry is published ten times a second",
    ("telemetry", "metrics_hosts"): "was removed; the page answers to this machine's name and addresses",
    ("log",): "was removed; everything from info on is logged; journalctl -p warning shows warnings and worse",
    ("watchdog", "repeats"): f"was removed; a Stop is repeated {STOP_REPEATS} times",
    ("watchdog", "repeat_interval_ms"): f"was removed; a Stop is repeated every {STOP_REPEAT_MS:g} ms",
    ("zenoh", "connect"): "was removed; name what the gateway dials in the file of zenoh.config (connect.endpoints)",
    ("power", "cut_on"): "was removed: a Stop cuts the power of the servos that it stops",
    ("power", "bitrate"): "was removed: the board's bus runs at 1 Mbit/s",
    ("power", "idle_ma"): "was removed: a servo at rest may draw 150 mA",
    ("power", "settle_ms"): "was removed: a stopped servo may draw current for 300 ms",
}
"""Removed settings and sections, each with the sentence that names its replacement."""


def _without_emptied(tables: dict[str, Any]) -> dict[str, Any]:
    """Return the tables without empty removed sections, whose names an earlier installed file still contains."""
    return {name: table for name, table in tables.items() if table != {} or (name,) not in _REMOVED}


# ---- the environment


def _environment() -> tuple[Variables, list[tuple[str, SettingFault]]]:
    """Return the variables that begin with ENV_PREFIX, and the faults in them.

    A variable that names no setting is a fault. CONNECT_VARIABLE is for client commands and is skipped.
    """
    found: dict[Place, tuple[str, Any]] = {}
    faults: list[tuple[str, SettingFault]] = []
    for variable, text in sorted(os.environ.items()):
        if not variable.upper().startswith(ENV_PREFIX) or variable == CONNECT_VARIABLE:
            continue
        place = tuple(variable.removeprefix(ENV_PREFIX).lower().split("__"))
        kind = None if variable != variable.upper() else _kind(place)
        if kind is None:
            why = _REMOVED.get(place) or _REMOVED.get(place[:1]) or f"{NO_SETTING}; {_NAMES}"
            faults.append((variable, SettingFault(place, why)))
            continue
        try:
            found[place] = variable, json.loads(text) if get_origin(kind) is tuple else Text(text)
        except (ValueError, RecursionError):
            example = """write the list as JSON, such as '["tcp/127.0.0.1:7447"]'"""
            faults.append((variable, SettingFault(place, f"{echo(text)} is not allowed: {example}")))
    return found, faults


def _merged(tables: Mapping[str, Any], variables: Variables) -> dict[str, Any]:
    merged = dict(tables)
    for place, (_, value) in variables.items():
        merged = _put(merged, place, value)
    return merged


def _put(table: Mapping[str, Any], place: Place, value: Any) -> dict[str, Any]:
    name, *rest = place
    below = table.get(str(name))
    return {
        **table,
        str(name): _put(below if isinstance(below, Mapping) else {}, tuple(rest), value) if rest else value,
    }


def _kind(place: tuple[str, ...]) -> Any:
    match place:
        case ("limits", "servos", servo, name) if servo in SERVOS:
            return _kinds(ServoLimits).get(name)
        case ("watchdog", "landing", servo) if servo in SERVOS:
            return float
        case (section, name):
            kind = _kinds(_kinds(Settings).get(section, type)).get(name)
            return None if get_origin(kind) is Mapping else kind
        case _:
            return None


def _kinds(section: type) -> dict[str, Any]:
    return {each.name: each.type for each in fields(section)} if is_dataclass(section) else {}


_NAMES: Final = f"a variable is named like {ENV_PREFIX}SPI__DEVICE; the sections are {', '.join(_kinds(Settings))}"


def _variables_at(place: Place, variables: Variables) -> list[str]:
    """Return the variables that set the value at `place`, a part of it, or a table that contains it."""
    return [
        variable
        for set_place, (variable, _) in variables.items()
        if place[: len(set_place)] == set_place or set_place[: len(place)] == place
    ]
