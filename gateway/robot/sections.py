"""The tables of the settings' file, each with its defaults and ranges; `gateway.robot.settings` reads the file."""

from typing import Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from gateway.model.framing import Framing
from gateway.model.protocols import SpiProtocol
from gateway.text import key_name
from schemas.keys import MAX_SOURCE
from schemas.robot import SERVO_IDS

FOR_STOPS: Final = {"for": "stop-servos"}
"""Validation context in which too fast a clock or too short a pause for the framing is accepted."""
SERVOS: Final = frozenset(map(str, SERVO_IDS))


class Section(BaseModel):
    """One table of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


Finite = Field(allow_inf_nan=False)
AngleDeg = Annotated[float, Finite, Field(ge=0, le=180)]


class ZenohSettings(Section):
    """The gateway's Zenoh endpoints."""

    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    config: str = ""
    allow_insecure: bool = False


def device_path(path: str, example: str) -> str:
    """The path, if it can be one of a device. Raises ValueError."""
    if not path.startswith("/") or "\0" in path:
        raise ValueError(f"write the path of a device, such as {example}")
    return path


def _clock_of_protocol(before: dict[str, Any]) -> int:
    """The clock that is not set, by the settings before it."""
    protocol: SpiProtocol = before.get("protocol", SpiProtocol.HEXAPOD_1_0)
    return protocol.speed_hz


class SpiSettings(Section):
    """The device. The clock was measured to be clean at 2.5 MHz; the controller takes at most 20 MHz."""

    protocol: SpiProtocol = SpiProtocol.HEXAPOD_1_0
    device: str = "/dev/spidev0.0"
    speed_hz: Annotated[int, Field(ge=1, le=20_000_000)] = Field(default_factory=_clock_of_protocol)
    # The default is for --sim only: `load` requires it for a real device.
    framing: Framing = Framing.PLAIN
    # The published firmware needed 6 (measured), or 20 if its loop takes twice the estimate. At most 1 ms: the gateway
    # waits for the pause, six times for six legs.
    frame_gap_us: Annotated[float, Finite, Field(ge=0, le=1000)] = 50.0

    @property
    def spoken(self) -> str:
        """What the controller has to understand, in a word."""
        return self.framing if self.protocol is SpiProtocol.HEXAPOD_1_0 else self.protocol

    @property
    def avoid_cdeg(self) -> tuple[int, int] | None:
        """Wire angles that are never sent, in hundredths of a degree: first <= angle < second; None: all are sent."""
        return None if self.protocol.measures else self.framing.avoid_cdeg

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
    """The controller's own line; with elkapod-2025 only."""

    uart: str = "/dev/ttyAMA1"
    # No heartbeat or no well-formed answer for this long is a fault, as a lost bus is. At least five cycles: one answer
    # may be lost, and one late.
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


SIMULATED: Final = "sim"
"""The interface of a simulated power board."""


class PowerSettings(Section):
    """The board on CAN that switches each servo's supply; none by default."""

    # "": no board; "sim": a simulated one; else an interface of python-can.
    interface: Annotated[str, Field(max_length=32, pattern=r"^[a-z0-9_-]*$")] = ""
    channel: str = "can0"
    # The servos on its outputs 1 to 18; (): 11, 12, 13, 21 … 63.
    servos: tuple[int, ...] = ()
    # It answers within 55 ms; where a mask meets its counter one pass behind an answer, within 394 ms.
    confirm_ms: Annotated[float, Finite, Field(ge=60, le=2000)] = 450.0

    @property
    def outputs(self) -> tuple[int, ...]:
        """The servo on each of the board's outputs, in their order."""
        return self.servos or SERVO_IDS

    @field_validator("interface")
    @classmethod
    def _is_within_reach(cls, interface: str) -> str:
        if interface == "gs_usb":  # python-can's goes around the kernel by libusb, whose devices the unit denies
            raise ValueError('Linux has a driver for this adapter: write interface = "socketcan", channel = "can0"')
        return interface

    @field_validator("servos")
    @classmethod
    def _each_once(cls, servos: tuple[int, ...]) -> tuple[int, ...]:
        if servos and sorted(servos) != sorted(SERVO_IDS):
            raise ValueError("write all 18 servos, each once, in the order of the board's outputs, or [] for 11 to 63")
        return servos


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
        if servo not in SERVOS:
            raise ValueError(
                f"{key_name(servo)} is no servo; an id is the leg (1 to 6) and the joint (1 to 3), such as 32"
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
    landing_ms: Annotated[float, Finite, Field(ge=0, le=5000)] = 0.0
    landing: Annotated[dict[str, AngleDeg], AfterValidator(_known_servos)] = {}


class LeaseSettings(Section):
    """Whether driving requires the lease, and how long that lasts unrenewed."""

    required: bool = False
    # Clients renew at a third of it; below 200 a hiccup of a wireless network would end it.
    ttl_ms: Annotated[float, Finite, Field(ge=200, le=10_000)] = 1000.0


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


class StateSettings(Section):
    """The folder of what outlasts the gateway; "": systemd's state directory, without which nothing outlasts it."""

    path: AbsolutePath = ""


class TelemetrySettings(Section):
    """Whether frames are published, and the metrics page."""

    frames: bool = False
    metrics: str = ""

    @field_validator("metrics")
    @classmethod
    def _host_and_port(cls, value: str) -> str:
        host, _, port = value.rpartition(":")
        if value and not (host and port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
            raise ValueError('write a host and a port, such as "127.0.0.1:9464", or "" for none')
        return value
