"""The service's settings: frozen, validated, with units in their names; each fault is one line naming its place.

A TOML file gives them and environment variables override it (`HEXAPOD_SPI__DEVICE`). docs/interface.md lists them.
"""

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails

from gateway import nesting
from gateway.errors import ConfigError
from gateway.host import plain_settings
from gateway.model.frames import centidegrees
from gateway.model.framing import Framing
from gateway.model.protocols import SpiProtocol
from gateway.text import visible_json
from schemas.keys import MAX_SOURCE
from schemas.robot import SERVO_IDS

DEFAULT_PATH: Final = plain_settings.DEFAULT_PATH
ENV_PREFIX: Final = "HEXAPOD_"
FOR_STOPS: Final = {"for": "stop-servos"}
"""Validation context in which too fast a clock or too short a pause for the framing is accepted."""
_SERVOS: Final = frozenset(map(str, SERVO_IDS))


class Section(BaseModel):
    """One table of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


Finite = Field(allow_inf_nan=False)
AngleDeg = Annotated[float, Finite, Field(ge=0, le=180)]


class ZenohSettings(Section):
    """The gateway's Zenoh endpoints."""

    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[str, ...] = ()
    config: str = ""
    allow_insecure: bool = False


def device_path(path: str, example: str) -> str:
    """The path, if it can be one of a device. Raises ValueError."""
    if not path.startswith("/") or "\0" in path:
        raise ValueError(f"write the path of a device, such as {example}")
    return path


class SpiSettings(Section):
    """The device. The clock was measured to be clean at 2.5 MHz; the controller takes at most 20 MHz."""

    protocol: SpiProtocol = SpiProtocol.HEXAPOD_1_0
    device: str = "/dev/spidev0.0"
    # 1 000 000 with elkapod-2025, whose own driver has that.
    speed_hz: Annotated[int, Field(ge=1, le=20_000_000)] = SpiProtocol.HEXAPOD_1_0.speed_hz
    # The default is for --sim only: `load` requires it for a real device.
    framing: Framing = Framing.PLAIN
    batch: bool = True
    # The published firmware needed 6 (measured), or 20 if its loop takes twice the estimate. At most 1 ms: the gateway
    # waits for the pause, six times for six legs.
    frame_gap_us: Annotated[float, Finite, Field(ge=0, le=1000)] = 50.0
    # At most 10 s: until then a controller that is out of sync ignores each Set and first Stop.
    resync_ms: Annotated[float, Finite, Field(ge=0, le=10_000)] = 1000.0
    # None: the framing's own.
    avoid_deg: tuple[AngleDeg, ...] | None = None

    @property
    def avoid_cdeg(self) -> tuple[int, int] | None:
        """Wire angles that are never sent, in hundredths of a degree: first <= angle < second; None: all are sent."""
        if self.avoid_deg is None:
            return None if self.protocol.measures else self.framing.avoid_cdeg
        return (centidegrees(self.avoid_deg[0]), centidegrees(self.avoid_deg[1])) if self.avoid_deg else None

    @model_validator(mode="after")
    def _clock_of_protocol(self) -> Self:
        if "speed_hz" not in self.model_fields_set:
            object.__setattr__(self, "speed_hz", self.protocol.speed_hz)  # frozen only from here on
        return self

    @field_validator("avoid_deg")
    @classmethod
    def _interval(cls, angles: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if angles and (len(angles) != 2 or angles[0] >= angles[1]):
            raise ValueError("write where it begins and where it ends, such as [1.0, 4.0], or [] for none")
        return angles

    @field_validator("device")
    @classmethod
    def _path(cls, device: str) -> str:
        return device_path(device, "/dev/spidev0.0")

    @model_validator(mode="after")
    def _slow_enough(self, info: ValidationInfo) -> Self:
        framed = self.protocol is SpiProtocol.HEXAPOD_1_0 and info.context is not FOR_STOPS
        fault = "" if not framed else self.framing.too_fast(self.speed_hz, self.frame_gap_us)
        if fault:
            raise ValueError(fault)
        return self


class ControllerSettings(Section):
    """The controller's own line and pace; with elkapod-2025 only."""

    uart: str = "/dev/ttyAMA1"
    cycle_hz: Annotated[float, Finite, Field(ge=10, le=100)] = 50.0
    # No heartbeat or no well-formed answer for so long is a fault, as a lost bus is.
    silent_ms: Annotated[float, Finite, Field(ge=100, le=2000)] = 300.0

    @field_validator("uart")
    @classmethod
    def _path(cls, uart: str) -> str:
        return device_path(uart, "/dev/ttyAMA1")


class SafetySettings(Section):
    """Rules that need what the robot measures; 0: never."""

    min_battery_v: Annotated[float, Finite, Field(ge=0, le=100)] = 0.0
    max_tilt_deg: Annotated[float, Finite, Field(ge=0, le=90)] = 0.0

    @field_validator("max_tilt_deg")
    @classmethod
    def _beyond_walking(cls, tilt_deg: float) -> float:
        if 0 < tilt_deg < 10:
            raise ValueError("write 10 to 90, since a robot that walks tilts by some degrees, or 0 for never")
        return tilt_deg


class ServoLimits(Section):
    """Range of one servo, in degrees, both ends included, and its speed; 0: unlimited."""

    min_deg: AngleDeg = 0.0
    max_deg: AngleDeg = 180.0
    # The slowest is 0.01°/s, the resolution of frames.
    max_speed_deg_s: Annotated[float, Finite, Field(ge=0, le=1000)] = 0.0

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.min_deg > self.max_deg:
            raise ValueError(f"min_deg is {self.min_deg:g} and max_deg {self.max_deg:g}; min_deg must not be larger")
        return self


Named = TypeVar("Named")


def _known_servos(servos: dict[str, Named]) -> dict[str, Named]:
    for servo in servos:
        if servo not in _SERVOS:
            raise ValueError(
                f"{_name(servo)} is no servo; an id is the leg (1 to 6) and the joint (1 to 3), such as 32"
            )
    return servos


class LimitSettings(Section):
    """Limits for commands of a leg. The controller's PWM runs at 50 Hz, so a higher rate changes nothing."""

    leg_rate_hz: Annotated[float, Finite, Field(ge=1, le=1000)] = 50.0
    max_age_ms: Annotated[float, Finite, Field(ge=0, le=60_000)] = 500.0
    start_stagger_ms: Annotated[float, Finite, Field(ge=0, le=2000)] = 0.0
    servos: Annotated[dict[str, ServoLimits], AfterValidator(_known_servos)] = {}


class WatchdogSettings(Section):
    """Silence stops a leg. It cannot be switched off."""

    timeout_ms: Annotated[float, Finite, Field(ge=20, le=10_000)] = 250.0
    scope: Literal["leg", "robot"] = "leg"
    repeats: Annotated[int, Field(ge=0, le=100)] = 3
    repeat_interval_ms: Annotated[float, Finite, Field(ge=1, le=1000)] = 20.0
    landing_ms: Annotated[float, Finite, Field(ge=0, le=5000)] = 0.0
    landing: Annotated[dict[str, AngleDeg], AfterValidator(_known_servos)] = {}


class LeaseSettings(Section):
    """Whether driving requires the lease, how long that lasts unrenewed, and whether it can be taken over."""

    required: bool = False
    # Clients renew at a third of it; below 200 a hiccup of a wireless network would end it.
    ttl_ms: Annotated[float, Finite, Field(ge=200, le=10_000)] = 1000.0
    takeover: Literal["stop", "never"] = "stop"


class ButtonSettings(Section):
    """How many stop buttons must be alive for the robot to move, and for how long a check-in counts."""

    # More than eight people watch no robot of this size.
    required: Annotated[int, Field(ge=0, le=8)] = 0
    # A browser runs a background page once a second, which by this default means a stop (docs/buttons.md).
    timeout_ms: Annotated[float, Finite, Field(ge=200, le=10_000)] = 1000.0
    # At most 64 people; each name as long as a command's `source` may be.
    names: Annotated[tuple[Annotated[str, Field(min_length=1, max_length=MAX_SOURCE)], ...], Field(max_length=64)] = ()


def _absolute(path: str) -> str:
    if (path and not path.startswith("/")) or "\0" in path:
        raise ValueError('write a whole path, from / on, such as one below /var/lib/hexapod-gateway, or "" for none')
    return path


AbsolutePath = Annotated[str, AfterValidator(_absolute)]


class CalibrationSettings(Section):
    """The calibration's file; "": in the state directory, or in memory only."""

    path: AbsolutePath = ""


class RecorderSettings(Section):
    """The black box: at least the 10 s before an incident; for more than ten minutes there are recordings."""

    path: AbsolutePath = ""
    seconds: Annotated[float, Finite, Field(ge=10, le=600)] = 60.0


class TelemetrySettings(Section):
    """Rates of the state and of what the robot measures, whether frames are published, and the metrics page."""

    state_hz: Annotated[float, Finite, Field(ge=0, le=1000)] = 10.0
    rate_hz: Annotated[float, Finite, Field(ge=0, le=100)] = 10.0
    frames: bool = False
    metrics: str = ""
    metrics_hosts: tuple[str, ...] = ()

    @field_validator("metrics")
    @classmethod
    def _host_and_port(cls, value: str) -> str:
        host, _, port = value.rpartition(":")
        if value and not (host and port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
            raise ValueError('write a host and a port, such as "127.0.0.1:9464", or "" for none')
        return value


class LogSettings(Section):
    """Level and format of the log."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["auto", "console", "json"] = "auto"


class Settings(Section):
    """All settings of one service."""

    zenoh: ZenohSettings = ZenohSettings()
    spi: SpiSettings = SpiSettings()
    controller: ControllerSettings = ControllerSettings()
    limits: LimitSettings = LimitSettings()
    watchdog: WatchdogSettings = WatchdogSettings()
    lease: LeaseSettings = LeaseSettings()
    buttons: ButtonSettings = ButtonSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    recorder: RecorderSettings = RecorderSettings()
    telemetry: TelemetrySettings = TelemetrySettings()
    safety: SafetySettings = SafetySettings()
    log: LogSettings = LogSettings()

    @model_validator(mode="after")
    def _known_to_protocol(self) -> Self:
        protocol = self.spi.protocol
        if protocol.starts_whole and self.limits.start_stagger_ms:
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
        from_file = _read(path)
    except ConfigError as error:
        lines.append(str(error))
        unread = True
    in_file = _faults_of_file(from_file, context)
    variables, faults = _environment()
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

    A variable that names no setting is a fault. pydantic-settings would ignore it, accept lower case, name no variable
    for a list that is no JSON, and take 0.1 s at each start.
    """
    found: dict[Place, tuple[str, Any]] = {}
    faults: list[str] = []
    for variable, text in sorted(os.environ.items()):
        if not variable.upper().startswith(ENV_PREFIX):
            continue
        place = tuple(variable.removeprefix(ENV_PREFIX).lower().split("__"))
        if variable != variable.upper() or not _is_setting(place):
            faults.append(f"{_name(variable)}: is no setting; {_NAMES}")
            continue
        try:
            found[place] = variable, json.loads(text) if place in _LISTS else text
        except (ValueError, RecursionError):
            example = f"write the list as JSON, such as '{_LISTS[place]}'"
            faults.append(f"{variable}: {_echo(text)} will not do: {example}")
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
    ("zenoh", "connect"): '["tcp/127.0.0.1:7447"]',
    ("spi", "avoid_deg"): "[1.0, 4.0]",
    ("buttons", "names"): '["kitchen"]',
    ("telemetry", "metrics_hosts"): '["robot.local"]',
}
_NAMES: Final = f"a variable is named like {ENV_PREFIX}SPI__DEVICE; the sections are {', '.join(Settings.model_fields)}"


def _is_setting(place: tuple[str, ...]) -> bool:
    match place:
        case ("limits", "servos", servo, name):
            return servo in _SERVOS and name in ServoLimits.model_fields
        case ("watchdog", "landing", servo):
            return servo in _SERVOS
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
    """Place and sentence of each fault."""
    return [(_place(fault), _sentence(fault)) for fault in error.errors(include_url=False)]


def _place(fault: ErrorDetails) -> Place:
    found = fault.get("ctx", {}).get("error")
    return found.place if isinstance(found, _PlacedError) else fault["loc"]


def _sentence(fault: ErrorDetails) -> str:
    if fault["type"] == "missing":
        return MISSING
    if fault["type"] == "extra_forbidden":
        return "is no setting"
    if fault["type"] == "value_error":  # a sentence of our own
        return str(fault["ctx"]["error"])
    return f"{_echo(fault['input'])} will not do: {fault['msg'][0].lower()}{fault['msg'][1:]}"


def dotted(place: Place) -> str:
    """`spi.speed_hz`, `zenoh.listen[0]`; a name that is no bare TOML key is quoted."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{_name(part)}" for part in place)
    return text.removeprefix(".")


def _name(name: str) -> str:
    return name if re.fullmatch(r"[\w-]{1,80}", name, re.ASCII) else _echo(name)


def _echo(value: object) -> str:
    """The value on one line, cut to `_MAX_ECHO` characters."""
    text = visible_json(value)
    return text if len(text) <= _MAX_ECHO else text[:_MAX_ECHO] + "…"


MISSING: Final = "is missing"
_MAX_ECHO: Final = 80
