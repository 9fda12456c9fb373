"""The service's settings: frozen, checked, with units in their names. Each fault is one line that names its place.

They come from a TOML file; environment variables (`HEXAPOD_SPI__DEVICE`) override it. docs/interface.md lists them.
`stop-servos` reads its settings here, too, so nothing slow is imported.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self

from gateway.errors import ConfigError
from gateway.files import durable, nesting
from gateway.host import settings_table
from gateway.host.directories import CONFIGURATION
from gateway.host.settings_reader import NO_SETTING, Fault, ForStops, VariableText, dotted, read, read_for_stops
from gateway.model.frames import PROTOCOL_VERSION
from gateway.words.own_command import CONNECT_VARIABLE

ENV_PREFIX: Final = "HEXAPOD_"


@dataclass(frozen=True)
class Settings(settings_table.Section):
    """All settings of one service."""

    zenoh: settings_table.ZenohSettings = field(default_factory=settings_table.ZenohSettings)
    wire: settings_table.WireSettings = field(default_factory=settings_table.WireSettings)
    spi: settings_table.SpiSettings = field(default_factory=settings_table.SpiSettings)
    controller: settings_table.ControllerSettings = field(default_factory=settings_table.ControllerSettings)
    limits: settings_table.LimitSettings = field(default_factory=settings_table.LimitSettings)
    watchdog: settings_table.WatchdogSettings = field(default_factory=settings_table.WatchdogSettings)
    lease: settings_table.LeaseSettings = field(default_factory=settings_table.LeaseSettings)
    buttons: settings_table.ButtonSettings = field(default_factory=settings_table.ButtonSettings)
    state: settings_table.StateSettings = field(default_factory=settings_table.StateSettings)
    telemetry: settings_table.TelemetrySettings = field(default_factory=settings_table.TelemetrySettings)
    safety: settings_table.SafetySettings = field(default_factory=settings_table.SafetySettings)
    power: settings_table.PowerSettings = field(default_factory=settings_table.PowerSettings)

    @property
    def starts_whole(self) -> bool:
        """Whether only the whole robot can be started and stopped. A board whose supply starts servos starts each."""
        singly = self.wire.has_uart and self.power.interface
        return self.wire.capabilities.whole_robot and not singly

    @property
    def measures(self) -> bool:
        """Whether the wire or a power board measures anything for telemetry."""
        return self.wire.measures or bool(self.power.interface)

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
            limits = replace(self.limits, start_stagger_ms=0.0 if at_once else settings_table.START_STAGGER_MS)
            object.__setattr__(self, "limits", limits)

    @classmethod
    def of(cls, tables: Mapping[str, Any]) -> Self:
        """Return settings from a TOML file's tables. Raises ConfigError with one line for each fault."""
        faults: list[Fault] = []
        found = read(cls, tables, faults)
        _raise([f"{dotted(place)}: {sentence}" for place, sentence in faults])
        return found

    def faults(self) -> Iterable[tuple[settings_table.Place, str]]:
        wire = self.wire.name
        if too_fast := self.spi.framing.too_fast(self.spi.speed_hz, self.spi.frame_gap_us):
            yield ("spi",), too_fast
        if self.starts_whole and self.power.interface:
            yield ("power", "interface"), f"{wire} starts all servos at once, which no power board does"
        if self.starts_whole and self.limits.start_stagger_ms:
            yield _STAGGER, f"{wire} starts all servos at once, so leave it at 0"
        if self.limits.start_stagger_ms >= self.watchdog.timeout_ms:
            longest = f"watchdog.timeout_ms, {self.watchdog.timeout_ms:g}"
            yield _STAGGER, f"a leg's start may not wait for as long as {longest}"
        for each in fields(self.safety):
            by_board = each.name == "min_battery_v" and self.power.interface
            if getattr(self.safety, each.name) and not (self.wire.measures or by_board):
                yield ("safety", each.name), f"{wire} has nothing that measures it; leave it at 0"
        for servo, angle_deg in self.watchdog.landing.items():
            limits = self.limits.servos.get(servo, settings_table.ServoLimits())
            if not limits.min_deg <= angle_deg <= limits.max_deg:
                allowed = f"limits.servos.{servo} allows {limits.min_deg:g} to {limits.max_deg:g}"
                yield ("watchdog", "landing", servo), f"{angle_deg:g} is not allowed: {allowed}"


SIMULATED_BOARD: Final = (
    'with a real controller, a simulated board ("sim") would confirm Stops that nothing has carried out; set the '
    'interface of the real board, or "" for none; without a robot: run --sim'
)
_STAGGER: Final = ("limits", "start_stagger_ms")


_MOST_FAULTS: Final = 20
"""In a file of another kind each line may be a fault; `check` took 15 s to print 50 000."""


def _raise(lines: Sequence[str], kind: type[ConfigError] = ConfigError) -> None:
    if lines:
        more = [f"and {len(lines) - _MOST_FAULTS} more faults"] if len(lines) > _MOST_FAULTS else []
        raise kind("\n".join([*lines[:_MOST_FAULTS], *more]))


class FramingNotSetError(ConfigError):
    """spi.framing is not set. The text lists all other faults, too."""


Variables = Mapping[tuple[str, ...], tuple[str, VariableText]]
"""Environment variables and their texts, by the setting that they set."""


def load(path: Path | None = None, *, simulated: bool = False) -> Settings:
    """Return the settings from `path` (None: the default file, if there is one) and the environment.

    Raises ConfigError with one line for each fault; the line names the file's entry or the variable. Unless the
    controller is `simulated`, the power board must be real, and spi.framing must be set: plain frames overrun the
    published firmware's buffer, after which no Stop reaches its servos until a reset.
    """
    tables, variables = _read(path), _variables()
    in_file, faults = list[Fault](), list[Fault]()
    read(Settings, tables, in_file)
    _merge(tables, variables)
    found = read(Settings, tables, faults)
    lines = [_line(path, fault) for fault in in_file]
    lines += [_line(path, fault, variables) for fault in faults if fault not in in_file]
    if not simulated:
        if found.power.interface == settings_table.SIMULATED:
            lines.append(_line(path, (("power", "interface"), SIMULATED_BOARD), variables))
        _require_framing(path, found.wire, tables.get("spi", {}), lines)
    _raise(lines)
    return found


def load_for_stops(path: Path | None = None) -> ForStops:
    """Return the settings that `stop-servos` needs. Raises ConfigError if [spi] or the UART is wrong.

    Everything else is ignored, even removed settings. `SpiSettings.within_limits` adds the framing's limits.
    """
    tables, variables = _read(path), _variables()
    _merge(tables, variables)
    found, faults = read_for_stops(tables)
    lines = [_line(path, fault, variables) for fault in faults]
    _require_framing(path, found.wire, tables.get("spi", {}), lines)
    _raise(lines)
    return found


def _line(path: Path | None, fault: Fault, variables: Variables = MappingProxyType({})) -> str:
    """Return the fault after its variables, which set its value, a part of it, or a table that contains it; else after
    its place in the file."""
    place, sentence = fault
    named = [variable for at, (variable, _) in variables.items() if place[: len(at)] == at or at[: len(place)] == place]
    hint = f"; a variable is named like {ENV_PREFIX}SPI__DEVICE" if named and sentence == NO_SETTING else ""
    return f"{' and '.join(named) or f'{path or CONFIGURATION}: {dotted(place)}'}: {sentence}{hint}"


_WHICH_FRAMING: Final = (
    'is not set (after any "plain" frame the published STM32 firmware needs a reset); without a controller: run --sim',
    'a controller written to the protocol document needs "plain"',
    'the published STM32 firmware needs "length-prefixed"',
)


def _require_framing(path: Path | None, wire: settings_table.WireSettings, spi: object, lines: list[str]) -> None:
    if wire.framed and isinstance(spi, Mapping) and not {"framing", "protocol"} & spi.keys():
        which = [f"{path or CONFIGURATION}: spi.framing: {sentence}" for sentence in _WHICH_FRAMING]
        _raise([*lines[: _MOST_FAULTS - len(which)], *which], FramingNotSetError)


def overrides(variables: Mapping[str, str]) -> dict[str, str]:
    """Return those of `variables` that override a file's settings for Stops."""
    prefixes = tuple(f"{ENV_PREFIX}{section.upper()}__" for section in settings_table.FOR_STOPS)
    return {name: value for name, value in variables.items() if name.upper().startswith(prefixes)}


# ---- the file


def _read(path: Path | None) -> dict[str, Any]:
    found = path or CONFIGURATION
    try:
        data = durable.read(found, nesting.MOST_BYTES)  # not from a FIFO, for whose writer a Stop would wait
        if data is None and path is not None:
            raise ConfigError(f"{found}: there is no such file; name another with --config")
        return nesting.read_toml(data or b"")
    except OSError as error:
        raise ConfigError(f"{found}: cannot be read ({error.strerror}); name another file with --config") from error
    except ValueError as error:
        raise ConfigError(f"{found}: {error}") from error


# ---- the environment


def _variables() -> Variables:
    """Return the variables that begin with ENV_PREFIX. One that names no setting of a section is its own place."""
    found: dict[tuple[str, ...], tuple[str, VariableText]] = {}
    for variable, text in sorted(os.environ.items()):
        # CONNECT_VARIABLE is for client commands.
        if variable.upper().startswith(ENV_PREFIX) and variable != CONNECT_VARIABLE:
            place = tuple(variable.removeprefix(ENV_PREFIX).lower().split("__"))
            misnamed = len(place) == 1 or variable != variable.upper()
            found[(variable,) if misnamed else place] = variable, VariableText(text)
    return found


def _merge(tables: dict[str, Any], variables: Variables) -> None:
    for (*path, last), (_, value) in variables.items():
        table = tables
        for name in path:
            if not isinstance(table.get(name), dict):
                table[name] = {}
            table = table[name]
        table[last] = value
