"""The service's settings: frozen, validated, with units in their names; each fault is one line naming its place.

A TOML file gives them and environment variables override it (`HEXAPOD_SPI__DEVICE`). docs/interface.md lists them.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Self

from pydantic import ValidationError, model_validator
from pydantic_core import ErrorDetails

from gateway import nesting
from gateway.errors import ConfigError
from gateway.host import plain_settings
from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS
from gateway.model.framing import Framing
from gateway.model.protocols import SpiProtocol
from gateway.own_command import CONNECT_VARIABLE
from gateway.robot.sections import (
    FOR_STOPS,
    SERVOS,
    ButtonSettings,
    ControllerSettings,
    LeaseSettings,
    LimitSettings,
    PowerSettings,
    SafetySettings,
    Section,
    ServoLimits,
    SpiSettings,
    StateSettings,
    TelemetrySettings,
    WatchdogSettings,
    ZenohSettings,
)
from gateway.text import echo, key_name

DEFAULT_PATH: Final = plain_settings.DEFAULT_PATH
ENV_PREFIX: Final = "HEXAPOD_"


class Settings(Section):
    """All settings of one service."""

    zenoh: ZenohSettings = ZenohSettings()
    spi: SpiSettings = SpiSettings()
    controller: ControllerSettings = ControllerSettings()
    limits: LimitSettings = LimitSettings()
    watchdog: WatchdogSettings = WatchdogSettings()
    lease: LeaseSettings = LeaseSettings()
    buttons: ButtonSettings = ButtonSettings()
    state: StateSettings = StateSettings()
    telemetry: TelemetrySettings = TelemetrySettings()
    safety: SafetySettings = SafetySettings()
    power: PowerSettings = PowerSettings()

    @property
    def starts_whole(self) -> bool:
        """Whether only the whole robot can be started and stopped: with a power board, each servo can."""
        return self.spi.protocol.starts_whole and not self.power.interface

    @model_validator(mode="after")
    def _known_to_protocol(self) -> Self:
        protocol = self.spi.protocol
        if self.starts_whole and self.limits.start_stagger_ms:
            why = f"{protocol} starts all servos at once, so leave it at 0"
            raise _PlacedError(("limits", "start_stagger_ms"), why)
        for name, value in self.safety:
            if value and not protocol.measures:
                raise _PlacedError(("safety", name), f"{protocol} has nothing that measures it; leave it at 0")
        return self

    @model_validator(mode="after")
    def _pose_within_limits(self) -> Self:
        for servo, angle_deg in self.watchdog.landing.items():
            limits = self.limits.servos.get(servo, ServoLimits())
            if not limits.min_deg <= angle_deg <= limits.max_deg:
                allowed = f"{limits.min_deg:g} to {limits.max_deg:g}"
                raise _PlacedError(
                    ("watchdog", "landing", servo),
                    f"{angle_deg:g} will not do: limits.servos.{servo} allows {allowed}",
                )
        return self


Place = tuple[int | str, ...]
"""Path to a value: ("spi", "speed_hz"), ("zenoh", "listen", 0), ("limits", "servos", "11", "min_deg")."""
Fault = tuple[Place, str]


class _PlacedError(ValueError):
    """A fault found in the settings as a whole, with the place that pydantic does not give it."""

    def __init__(self, place: Place, sentence: str) -> None:
        super().__init__(sentence)
        self.place = place


Context = Mapping[str, str] | None
"""FOR_STOPS, or None."""


class FramingNotSetError(ConfigError):
    """spi.framing is not set; the text lists all other faults as well."""


def load(path: Path | None = None, *, simulated: bool = False, for_stops: bool = False) -> Settings:
    """Settings from `path` (else the default file, if there is one) and the environment.

    Raises ConfigError with one line per fault, naming the file's entry or the environment variable. Unless the
    controller is `simulated`, spi.framing must be set: plain frames overrun the published firmware's buffer, and no
    Stop reaches its servos until its reset. `for_stops`: spi.speed_hz and spi.frame_gap_us may exceed the framing's
    limits, since `stop-servos` uses the nearest allowed value (`plain_settings.within_limits`).
    """
    context = FOR_STOPS if for_stops else None
    from_file: dict[str, Any] = {}
    lines: list[str] = []
    unread = False
    try:
        from_file = _without_emptied(_read(path))
    except ConfigError as error:
        lines.append(str(error))
        unread = True
    variables, faults = _environment()
    if for_stops:  # which no file of an earlier version may prevent
        from_file = _without_removed(from_file)
        faults = [fault for fault in faults if not fault.endswith(tuple(_REMOVED.values()))]
    in_file = _faults_of_file(from_file, context)
    merged = from_file
    for place, (_, value) in variables.items():
        merged = _put(merged, place, value)
    lines += [f"{path or DEFAULT_PATH}: {dotted(place)}: {sentence}" for place, sentence in in_file]
    lines += faults
    places = {place for place, _ in in_file}
    lines += [
        f"{' and '.join(named) or dotted(place)}: {sentence}"
        for place, sentence in _faults(merged, context)
        if ((named := _variables_at(place, variables)) or place not in places) and (place, sentence) not in in_file
    ]
    spi = merged.get("spi", {})
    framed = isinstance(spi, Mapping) and spi.get("protocol") != SpiProtocol.ELKAPOD_2025
    if not (simulated or unread) and framed and "framing" not in spi:
        lines += [f"{path or DEFAULT_PATH}: spi.framing: {sentence}" for sentence in _WHICH_FRAMING]
        raise FramingNotSetError("\n".join(lines))
    if lines:
        raise ConfigError("\n".join(lines))
    return Settings.model_validate(merged, context=context)


_WHICH_FRAMING: Final = (
    'is not set (after any "plain" frame the published STM32 firmware needs a reset); without a controller: run --sim',
    *(f'{each.controller} needs "{each}"' for each in Framing),
)


# ---- the file


def _read(path: Path | None) -> dict[str, Any]:
    found = path or DEFAULT_PATH
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


_IN_STATE: Final = "was removed; name its folder with state.path, which has all that outlasts the gateway"
_REMOVED: Final[Mapping[Place, str]] = {
    ("calibration",): f"{_IN_STATE} (the calibration as calibration.toml)",
    ("recorder",): f"{_IN_STATE} (the black box keeps 60 s)",
    ("spi", "batch"): "was removed; lists of transfers are written, and single ones where the kernel takes no lists",
    ("spi", "resync_ms"): "was removed; length-prefixed framing synchronises a stream once a second",
    ("spi", "avoid_deg"): "was removed; it follows from the framing",
    ("controller", "cycle_hz"): "was removed; the controller's cycle is 50 Hz",
    ("lease", "takeover"): "was removed; everybody may take the lease, which stops all legs first",
    ("telemetry", "state_hz"): "was removed; the state comes ten times a second",
    ("telemetry", "rate_hz"): "was removed; what the robot measures comes ten times a second",
    ("telemetry", "metrics_hosts"): "was removed; the page answers to this machine's name and addresses",
    ("log",): "was removed; all from info on is logged, and journalctl -p warning shows only what is worse",
    ("watchdog", "repeats"): f"was removed; a Stop is repeated {STOP_REPEATS} times",
    ("watchdog", "repeat_interval_ms"): f"was removed; a Stop is repeated each {STOP_REPEAT_MS:g} ms",
    ("zenoh", "connect"): "was removed; name what the gateway dials in the file of zenoh.config (connect.endpoints)",
    ("power", "cut_on"): "was removed: a Stop takes the supply of what it stops",
    ("power", "bitrate"): "was removed: the board's bus runs at 1 Mbit/s",
    ("power", "idle_ma"): "was removed: a servo at rest may draw 150 mA",
    ("power", "settle_ms"): "was removed: a stopped servo may draw current for 300 ms",
}
"""Settings, and whole sections, of earlier versions, and what takes their place."""


def _without_emptied(tables: dict[str, Any]) -> dict[str, Any]:
    """The same without removed sections that set nothing: the file that was installed earlier has their names."""
    return {name: table for name, table in tables.items() if table != {} or (name,) not in _REMOVED}


def _without_removed(tables: dict[str, Any]) -> dict[str, Any]:
    """The same without all settings of earlier versions."""
    kept = {name: table for name, table in tables.items() if (name,) not in _REMOVED}
    return {
        section: {name: value for name, value in table.items() if (section, name) not in _REMOVED}
        if isinstance(table, dict)
        else table
        for section, table in kept.items()
    }


def _faults_of_file(values: dict[str, Any], context: Context) -> list[Fault]:
    """Strict, since a TOML value has a type: "50" is no number."""
    # Validated as JSON, since strict Python types reject TOML's arrays and strings for tuples and enumerations; and
    # again unchanged, since JSON turns TOML's dates into strings.
    faults = _faults(json.dumps(values, default=str), context)
    places = {place for place, _ in faults}
    return faults + [fault for fault in _faults(values, context) if fault[0] not in places]


# ---- the environment


def _environment() -> tuple[dict[Place, tuple[str, Any]], list[str]]:
    """Variables that begin with ENV_PREFIX: by place, the variable and its value as in a file; and faults.

    A variable that names no setting is a fault, but for CONNECT_VARIABLE, which is for client commands.
    pydantic-settings would ignore it, accept lower case, name no variable for a list that is no JSON, and take 0.1 s at
    each start.
    """
    found: dict[Place, tuple[str, Any]] = {}
    faults: list[str] = []
    for variable, text in sorted(os.environ.items()):
        if not variable.upper().startswith(ENV_PREFIX) or variable == CONNECT_VARIABLE:
            continue
        place = tuple(variable.removeprefix(ENV_PREFIX).lower().split("__"))
        if variable != variable.upper() or not _is_setting(place):
            why = _REMOVED.get(place) or _REMOVED.get(place[:1]) or f"is no setting; {_NAMES}"
            faults.append(f"{key_name(variable)}: {why}")
            continue
        try:
            found[place] = variable, json.loads(text) if place in _LISTS else text
        except (ValueError, RecursionError):
            example = f"write the list as JSON, such as '{_LISTS[place]}'"
            faults.append(f"{variable}: {echo(text)} will not do: {example}")
    return found, faults


def _put(table: Mapping[str, Any], place: Place, value: Any) -> dict[str, Any]:
    """A copy of the table with the value at this place."""
    name, *rest = place
    below = table.get(str(name))
    return {
        **table,
        str(name): _put(below if isinstance(below, Mapping) else {}, tuple(rest), value) if rest else value,
    }


_LISTS: Final[Mapping[Place, str]] = {
    ("zenoh", "listen"): '["tcp/127.0.0.1:7447"]',
    ("buttons", "names"): '["kitchen"]',
    ("power", "servos"): "[]",
}
_NAMES: Final = f"a variable is named like {ENV_PREFIX}SPI__DEVICE; the sections are {', '.join(Settings.model_fields)}"


def _is_setting(place: tuple[str, ...]) -> bool:
    match place:
        case ("limits", "servos", servo, name):
            return servo in SERVOS and name in ServoLimits.model_fields
        case ("watchdog", "landing", servo):
            return servo in SERVOS
        case (section, name) if section in Settings.model_fields:
            return place not in _TABLES and name in getattr(_DEFAULTS, section).__class__.model_fields
        case _:
            return False


_DEFAULTS: Final = Settings()
_TABLES: Final = (("limits", "servos"), ("watchdog", "landing"))


def _variables_at(place: Place, variables: Mapping[Place, tuple[str, Any]]) -> list[str]:
    """The variables that set the value at `place`, a part of it, or a table that contains it."""
    return [
        variable
        for set_place, (variable, _) in variables.items()
        if place[: len(set_place)] == set_place or set_place[: len(place)] == place
    ]


# ---- both


def _faults(values: dict[str, Any] | str, context: Context) -> list[Fault]:
    """Faults of a table, in which text is converted (the environment has only text), or of JSON, strictly."""
    try:
        if isinstance(values, str):
            Settings.model_validate_json(values, strict=True, context=context)
        else:
            Settings.model_validate(values, context=context)
    except ValidationError as error:
        return faults_of(error)
    return []


def faults_of(error: ValidationError) -> list[Fault]:
    """Place and sentence of each fault; a default that follows from a faulty value is none of its own."""
    return [
        (_place(fault), _sentence(fault))
        for fault in error.errors(include_url=False)
        if fault["type"] != "default_factory_not_called"
    ]


def _place(fault: ErrorDetails) -> Place:
    found = fault.get("ctx", {}).get("error")
    return found.place if isinstance(found, _PlacedError) else fault["loc"]


def _sentence(fault: ErrorDetails) -> str:
    if fault["type"] == "missing":
        return MISSING
    if fault["type"] == "extra_forbidden":
        return _REMOVED.get(fault["loc"], "is no setting")
    if fault["type"] == "value_error":  # a sentence of our own
        return str(fault["ctx"]["error"])
    return f"{echo(fault['input'])} will not do: {fault['msg'][0].lower()}{fault['msg'][1:]}"


def dotted(place: Place) -> str:
    """`spi.speed_hz`, `zenoh.listen[0]`; a name that is no bare TOML key is quoted."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{key_name(part)}" for part in place)
    return text.removeprefix(".")


MISSING: Final = "is missing"
