"""The service's settings: frozen, checked, units in their names, and one line per fault that names the place.

A TOML file gives them, environment variables override it (`HEXAPOD_SPI__DEVICE`), the defaults are the contract's.
"""

import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails
from pydantic_settings import BaseSettings, EnvSettingsSource, SettingsConfigDict, SettingsError

from gateway.errors import ConfigError
from gateway.protocol.framing import Framing
from schemas.robot import SERVO_IDS

DEFAULT_PATH: Final = Path("/etc/hexapod-gateway/gateway.toml")
ENV_PREFIX: Final = "HEXAPOD_"


class Section(BaseModel):
    """One table of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


Finite = Field(allow_inf_nan=False)


class ZenohSettings(Section):
    """Where clients reach the gateway, and what it dials."""

    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    connect: tuple[str, ...] = ()
    config: str = ""
    allow_insecure: bool = False


class SpiSettings(Section):
    """The device; 2.5 MHz is what v1.0.0 was measured to keep a clean clock at, 20 MHz the controller's most."""

    device: str = "/dev/spidev0.0"
    speed_hz: Annotated[int, Field(ge=1, le=20_000_000)] = 2_500_000
    framing: Framing = Framing.PLAIN
    # At most a millisecond: the pause holds the loop, six legs at a time.
    frame_gap_us: Annotated[float, Finite, Field(ge=0, le=1000)] = 100.0


AngleDeg = Annotated[float, Finite, Field(ge=0, le=180)]


class ServoLimits(Section):
    """How far one servo may go, in degrees, both ends included."""

    min_deg: AngleDeg = 0.0
    max_deg: AngleDeg = 180.0

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.min_deg > self.max_deg:
            raise ValueError(f"min_deg is {self.min_deg:g} and max_deg {self.max_deg:g}; min_deg must not be larger")
        return self


class LimitSettings(Section):
    """What a publisher can ask of a leg; the controller's PWM runs at 50 Hz, so a higher rate changes nothing."""

    leg_rate_hz: Annotated[float, Finite, Field(ge=1, le=1000)] = 50.0
    max_age_ms: Annotated[float, Finite, Field(ge=0, le=60_000)] = 0.0
    start_stagger_ms: Annotated[float, Finite, Field(ge=0, le=2000)] = 0.0
    servos: dict[str, ServoLimits] = {}

    @field_validator("servos")
    @classmethod
    def _servos_exist(cls, servos: dict[str, ServoLimits]) -> dict[str, ServoLimits]:
        for servo in servos:
            if servo not in map(str, SERVO_IDS):
                raise ValueError(f"{servo} is no servo; an id is the leg (1 to 6) and the joint (1 to 3), such as 32")
        return servos


class WatchdogSettings(Section):
    """Silence stops a leg. It cannot be switched off."""

    timeout_ms: Annotated[float, Finite, Field(ge=20, le=10_000)] = 250.0
    scope: Literal["leg", "robot"] = "leg"
    repeats: Annotated[int, Field(ge=0, le=100)] = 3
    repeat_interval_ms: Annotated[float, Finite, Field(ge=1, le=1000)] = 20.0


class TelemetrySettings(Section):
    """What goes out besides acknowledgements."""

    state_hz: Annotated[float, Finite, Field(ge=0, le=1000)] = 10.0
    frames: bool = False
    metrics: str = ""

    @field_validator("metrics")
    @classmethod
    def _host_and_port(cls, value: str) -> str:
        host, _, port = value.rpartition(":")
        if value and not (host and port.isdecimal() and 0 < int(port) < 65536):
            raise ValueError('write a host and a port, such as "127.0.0.1:9464", or "" for none')
        return value


class LogSettings(Section):
    """How much is logged, and how it looks."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["auto", "console", "json"] = "auto"


class Settings(Section):
    """All settings of one service."""

    zenoh: ZenohSettings = ZenohSettings()
    spi: SpiSettings = SpiSettings()
    limits: LimitSettings = LimitSettings()
    watchdog: WatchdogSettings = WatchdogSettings()
    telemetry: TelemetrySettings = TelemetrySettings()
    log: LogSettings = LogSettings()


class _FromEnvironment(Settings, BaseSettings):
    """The same settings, as pydantic-settings looks for them in the environment."""

    model_config = SettingsConfigDict(
        env_prefix=ENV_PREFIX, env_nested_delimiter="__", nested_model_default_partial_update=True
    )


def load(path: Path | None = None) -> Settings:
    """Settings from `path` (else the default file, if there is one) and the environment.

    Raises ConfigError with one line per fault; each names the file's entry or the environment variable.
    """
    if path is None:
        path = DEFAULT_PATH if DEFAULT_PATH.exists() else None
    from_file = _read(path) if path is not None else {}
    faults = [f"{path}: {line}" for line in _faults(from_file, strict=True)]
    from_environment = _environment()
    merged = _overlay(from_file, from_environment)
    faults += _unknown_sections()
    faults += [
        f"{_variable(place)}: {text}" for place, text in _located_faults(merged) if _has(from_environment, place)
    ]
    if faults:
        raise ConfigError("\n".join(faults))
    return Settings.model_validate(merged)


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); name another file with --config") from error
    except ValueError as error:  # TOML's own errors, and bytes that are no UTF-8
        raise ConfigError(f"{path}: is not TOML: {error}") from error


def _environment() -> dict[str, Any]:
    try:
        return EnvSettingsSource(_FromEnvironment)()
    except SettingsError as error:
        raise ConfigError(
            f"{ENV_PREFIX}…: {error}; a list is written as JSON, such as '[\"tcp/127.0.0.1:7447\"]'"
        ) from error


def _unknown_sections() -> list[str]:
    """Variables with our prefix that pydantic-settings passes over, because they name no section."""
    sections = Settings.model_fields.keys()
    return [
        f"{name}: is no setting; the sections are {', '.join(sections)}"
        for name in sorted(os.environ)
        if name.startswith(ENV_PREFIX) and name.removeprefix(ENV_PREFIX).split("__")[0].lower() not in sections
    ]


Place = tuple[int | str, ...]


def _located_faults(values: dict[str, Any]) -> list[tuple[Place, str]]:
    try:
        Settings.model_validate(values)
    except ValidationError as error:
        return [(fault["loc"], _sentence(fault)) for fault in error.errors(include_url=False)]
    return []


def _faults(values: dict[str, Any], *, strict: bool) -> list[str]:
    """A file says what type a value has, so nothing is converted: "50" is no number there."""
    try:
        # As JSON, since TOML has arrays and strings where the settings have tuples and enumerations.
        Settings.model_validate_json(json.dumps(values, default=str), strict=strict)
    except ValidationError as error:
        return [f"{'.'.join(map(str, f['loc']))}: {_sentence(f)}" for f in error.errors(include_url=False)]
    return []


def _sentence(fault: ErrorDetails) -> str:
    if fault["type"] == "extra_forbidden":
        return "is no setting"
    if fault["type"] == "value_error":  # a sentence of our own
        return str(fault["ctx"]["error"])
    return f"{json.dumps(fault['input'], default=str)} will not do: {fault['msg'][0].lower()}{fault['msg'][1:]}"


def _variable(place: Place) -> str:
    """The environment variable that set the value at `place` (list elements have none of their own)."""
    return ENV_PREFIX + "__".join(part.upper() for part in place if isinstance(part, str))


def _has(values: Any, place: Place) -> bool:
    for part in place:
        if not isinstance(values, Mapping):
            return True
        if part not in values:
            return False
        values = values[part]
    return True


def _overlay(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for name, value in above.items():
        old = merged.get(name)
        merged[name] = _overlay(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged
