"""The table of all settings: section, name, type, limits, default and meaning, each once.

`gateway.host.settings_reader` reads files by it, for the service and for `stop-servos`. `python -m release.interface_page`
makes the table in docs/interface.md and the JSON Schema (docs/settings.schema.json) from it. It imports no pydantic,
whose loading takes longer than all Stops.
"""

# ruff: noqa: E501, RUF009  (a row for each setting, however long; `_setting` returns a field)
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, Literal, NamedTuple

from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS, Framing
from gateway.model.protocols import BUILT_IN, FRAMED, SpiProtocol
from gateway.wire import GROUP, Capabilities, ServoWire
from gateway.words.text import key_name, visible
from schemas.keys import MAX_SOURCE
from schemas.robot import SERVO_IDS

SIMULATED: Final = "sim"
START_STAGGER_MS: Final = 15.0
"""A servo draws most current in its first milliseconds. Six legs start within 75 ms, well within a usual watchdog."""
DEFAULT_LISTEN: Final = ("tcp/127.0.0.1:7447",)

Place = tuple[int | str, ...]
"""Path to a value: ("spi", "speed_hz"), ("zenoh", "listen", 0), ("limits", "servos", "11", "min_deg")."""


class Allowed(NamedTuple):
    """A setting's meaning, and its allowed values besides its type."""

    meaning: str
    limits: tuple[float, float] | None = None
    """Both ends included."""
    fault: Callable[[Any], str] = lambda _value: ""
    """Returns why a value of the right type is wrong, or ""."""


def _setting(default: Any, meaning: str = "", limits: tuple[float, float] | None = None, **fault: Any) -> Any:
    allowed = {"allowed": Allowed(meaning, limits, **fault)}
    return (
        field(default_factory=dict, metadata=allowed) if default is dict else field(default=default, metadata=allowed)
    )


def _like(pattern: str, wanted: str) -> Callable[[str], str]:
    return lambda text: "" if re.fullmatch(pattern, text) else wanted


def _host_and_port(value: str) -> str:
    host, _, port = value.rpartition(":")
    if not value or (host and port.isascii() and port.isdecimal() and 0 < int(port) < 65536):
        return ""
    return 'write a host and a port, such as "127.0.0.1:9464", or "" for none'


def _beyond_walking(tilt_deg: float) -> str:
    wanted = "write 10 to 90, since a robot that walks tilts by some degrees, or 0 for never"
    return wanted if 0 < tilt_deg < 10 else ""


def _interface(name: str) -> str:
    if name == "gs_usb":  # python-can's goes around the kernel by libusb, whose devices the unit denies
        return 'Linux has a driver for this adapter: write interface = "socketcan", channel = "can0"'
    return _like("[a-z0-9_-]{0,32}", 'write a name of python-can, such as "socketcan", or "" for none')(name)


def _each_once(servos: tuple[int, ...]) -> str:
    wanted = "write all 18 servos, each once, in the order of the board's outputs, or [] for 11 to 63"
    return wanted if servos and sorted(servos) != sorted(SERVO_IDS) else ""


def _names(names: tuple[str, ...]) -> str:
    wanted = f"write at most 64 names, each of 1 to {MAX_SOURCE} characters"
    return "" if len(names) <= 64 and all(0 < len(name) <= MAX_SOURCE for name in names) else wanted


def load_plugin(name: str, options: Mapping[str, object]) -> ServoWire:
    """Return a plug-in's wire, found by its entry point. Raises ValueError if it is missing, broken or rejects these."""
    from importlib.metadata import entry_points  # noqa: PLC0415  (a Stop over SPI does not wait for it)

    found = {each.name: each for each in entry_points(group=GROUP)}
    if name not in found:
        known = ", ".join(f'"{each}"' for each in (*BUILT_IN, *sorted(found.keys() - BUILT_IN.keys())))
        raise ValueError(f'there is no wire "{visible(name)}"; installed are {known}')
    named = f'"{name}" ({found[name].value})'
    try:
        made = found[name].load()(options)
    except ValueError:
        raise
    except BaseException as error:  # a foreign module may raise anything
        raise ValueError(f"{named} cannot be loaded with these options: {type(error).__name__}: {error}") from error
    if not isinstance(made, ServoWire) or not isinstance(made.capabilities, Capabilities):
        raise ValueError(f"{named} is no gateway.wire.ServoWire with its Capabilities")
    return made


class Section:
    """One table of the file."""

    def faults(self) -> Iterable[tuple[Place, str]]:
        """Return the places, below the section, and sentences of values that are valid alone but not together."""
        return ()


# fmt: off
@dataclass(frozen=True)
class ZenohSettings(Section):
    listen: tuple[str, ...] = _setting(DEFAULT_LISTEN, "endpoints on which clients reach the gateway")
    config: str = _setting("", "a Zenoh JSON5 file for TLS, access control, namespace, and what the gateway dials")
    allow_insecure: bool = _setting(False, "listen beyond loopback without certificates or passwords")


@dataclass(frozen=True)
class WireSettings(Section):
    name: str = _setting(str(FRAMED), "what the controller speaks ([protocol.md](protocol.md)): `hexapod-1.0`, `elkapod-2025` or a [plug-in](protocol.md#bring-your-own-wire), with its options as further keys. `spi.framing` and `spi.frame_gap_us` are for `hexapod-1.0`; a plug-in uses no `[spi]`")
    options: Mapping[str, object] = field(default_factory=dict, metadata={"others": True})

    @property
    def built_in(self) -> SpiProtocol | None:
        """The built-in wire of this name, or None for a plug-in."""
        return BUILT_IN.get(self.name)

    @cached_property
    def plugin(self) -> ServoWire:
        """The plug-in of this name. Raises ValueError if it is missing, broken or rejects its options."""
        return load_plugin(self.name, self.options)

    @property
    def framed(self) -> bool:
        """Whether the wire's frames need a framing (`spi.framing`)."""
        return self.built_in is FRAMED

    @property
    def has_uart(self) -> bool:
        """Whether a UART starts and stops the servos. With a power board, supply then starts each."""
        return self.built_in is not None and not self.framed

    @property
    def measures(self) -> bool:
        """Whether the controller returns telemetry, by its UART. A plug-in has no way to hand measurements over."""
        return self.has_uart

    @property
    def capabilities(self) -> Capabilities:
        """The wire's capabilities; the default ones if a plug-in cannot be loaded."""
        if self.built_in is not None:
            return self.built_in.capabilities
        try:
            return self.plugin.capabilities
        except ValueError:  # `faults` reports it
            return Capabilities()

    def faults(self) -> Iterable[tuple[Place, str]]:
        if self.built_in is not None and self.options:
            yield (), f"{', '.join(map(key_name, self.options))} is no setting of {self.name}"
        elif self.built_in is None:
            try:
                _ = self.plugin
            except ValueError as error:
                yield (), str(error)


@dataclass(frozen=True)
class SpiSettings(Section):
    """The device. The clock was measured to be clean at 2.5 MHz; the controller takes at most 20 MHz."""

    device: str = _setting("/dev/spidev0.0", fault=_like(r"/[^\0]*", "write the path of a device, such as /dev/spidev0.0"))
    # 0: the protocol's.
    speed_hz: int = _setting(0, "with `length-prefixed` 5000000 at most, else the published firmware loses bytes", (1, 20_000_000))
    # The default is for --sim only: a real device needs it to be set.
    framing: Framing = _setting(Framing.PLAIN, "what the controller needs; a real device requires it")
    # The published firmware needed 6 (measured), or 20 if its loop takes twice the estimate. At most 1 ms: the gateway
    # waits for the pause, six times for six legs.
    frame_gap_us: float = _setting(50.0, "least pause after a transfer, chip select asserted; then 10 µs released. With `length-prefixed` 20 at least, else the published firmware loses frames, Stops too", (0, 1000))

    def of(self, wire: WireSettings) -> "SpiSettings":
        """Return the settings for this wire: by default with its clock, and without a framing if it has none."""
        speed_hz = self.speed_hz or (wire.built_in or FRAMED).speed_hz
        return replace(self, speed_hz=speed_hz, framing=self.framing if wire.framed else Framing.PLAIN)

    def within_limits(self) -> tuple["SpiSettings", str]:
        """Return the settings with clock and pause within the framing's limits, and a sentence if that changed them.

        The service rejects such settings. `stop-servos` must neither fail for them nor lose Stops by them.
        """
        framing = self.framing
        if not (fault := framing.too_fast(self.speed_hz, self.frame_gap_us)):
            return self, ""
        speed_hz, gap_us = min(self.speed_hz, framing.most_hz), max(self.frame_gap_us, framing.least_gap_us)
        changed = f"spi: {fault}; stop-servos uses {speed_hz} Hz and {gap_us:g} µs"
        return replace(self, speed_hz=speed_hz, frame_gap_us=gap_us), changed


@dataclass(frozen=True)
class ControllerSettings(Section):
    uart: str = _setting("/dev/ttyAMA1", "with `elkapod-2025`: the UART of start, shutdown and heartbeat", fault=_like(r"/[^\0]*", "write the path of a device, such as /dev/ttyAMA1"))


@dataclass(frozen=True)
class ServoLimits(Section):
    """Range of one servo, in degrees, both ends included, and its speed; 0: unlimited."""

    min_deg: float = _setting(0.0, "of servo N, such as `[limits.servos.11]`", (0, 180))
    max_deg: float = _setting(180.0, "", (0, 180))
    # The slowest is 0.01°/s, the resolution of frames.
    max_speed_deg_s: float = _setting(0.0, "highest speed of a Set (Behaviour *Speed*); 0: any", (0, 1000))

    def faults(self) -> Iterable[tuple[Place, str]]:
        if self.min_deg > self.max_deg:
            yield (), f"min_deg is {self.min_deg:g} and max_deg {self.max_deg:g}; min_deg must not be larger"


@dataclass(frozen=True)
class LimitSettings(Section):
    """Limits for commands of a leg. The controller's PWM runs at 50 Hz, so a higher rate changes nothing."""

    leg_rate_hz: float = _setting(50.0, "frames a second and leg", (1, 1000))
    max_age_ms: float = _setting(500.0, "commands with `sent_ms` that are older are rejected; 0: off", (0, 60_000))
    # -1: START_STAGGER_MS, but not where the wire starts all legs at once, nor where a board feeds one servo after the other.
    start_stagger_ms: float = _setting(-1.0, "least pause between starting two legs; below `watchdog.timeout_ms`; 0: off", (0, 2000))
    # A third of a usual servo's own speed.
    takeover_deg_s: float = _setting(180.0, "highest speed after a change of source or soon after a Stop (Behaviour *Take-over and first frame*); 0: off", (0, 1000))
    servos: Mapping[str, ServoLimits] = _setting(dict)


@dataclass(frozen=True)
class WatchdogSettings(Section):
    timeout_ms: float = _setting(250.0, "silence that stops a leg; cannot be switched off", (20, 10_000))
    scope: Literal["leg", "robot"] = _setting("leg", "what one silent leg stops")
    landing_ms: float = _setting(0.0, "time to the landing pose before a silent robot stops; 0: a silent leg stops at once", (0, 5000))
    landing: Mapping[str, float] = _setting(dict, "the landing pose, such as `11 = 90.0`; a servo without one holds its angle", (0, 180))


@dataclass(frozen=True)
class LeaseSettings(Section):
    required: bool = _setting(False, "starts and sets are rejected while nobody holds the lease")
    # Clients renew at a third of it; below 200 a hiccup of a wireless network would end it.
    ttl_ms: float = _setting(1000.0, "silence that ends a lease", (200, 10_000))


@dataclass(frozen=True)
class ButtonSettings(Section):
    # More than eight people watch no robot of this size.
    required: int = _setting(0, "buttons that must be alive for anything to move", (0, 8))
    # A browser runs a background page once a second, which by this default means a stop (docs/driving.md).
    timeout_ms: float = _setting(1000.0, "time after a check-in for which a button is alive", (200, 10_000))
    names: tuple[str, ...] = _setting((), 'up to 64 people or roles (`"button"`, `"operator"`) whose buttons count (without certificates: names, up to the first `/`); `[]`: any', fault=_names)


@dataclass(frozen=True)
class StateSettings(Section):
    path: str = _setting("", "existing folder for emergency stop, calibration (`calibration.toml`), revocations and black box; `\"\"`: systemd's `STATE_DIRECTORY`, else nothing outlasts the process, and the black box is off", fault=_like(r"|/[^\0]*", 'write a whole path, from / on, such as one below /var/lib/hexapod-gateway, or "" for none'))


@dataclass(frozen=True)
class TelemetrySettings(Section):
    frames: bool = _setting(False, "publish `hexapod/frame`")
    metrics: str = _setting("", '`"127.0.0.1:9464"`: Prometheus [metrics](recordings.md#metrics) over HTTP; `""`: none', fault=_host_and_port)


@dataclass(frozen=True)
class SafetySettings(Section):
    min_battery_v: float = _setting(0.0, "lowest battery voltage for starts (Behaviour *Measurements*), which the controller or a power board measures; 0: any", (0, 100))
    max_tilt_deg: float = _setting(0.0, "tilt (10 at least) that stops or lands the robot; 0: any", (0, 90), fault=_beyond_walking)


@dataclass(frozen=True)
class PowerSettings(Section):
    interface: str = _setting("", 'the board that feeds the servos (Behaviour *Power*): `"sim"` (with a simulated controller only), or an interface of python-can, such as `"socketcan"` (also for gs_usb) or `"slcan"`; `""`: none', fault=_interface)
    channel: str = _setting("can0", 'its channel, such as `"can0"` or `"/dev/ttyACM0"`')
    servos: tuple[int, ...] = _setting((), "the servo on each output, 1 to 18; `[]`: 11, 12, 13, 21 … 63. `check --move` tests one", fault=_each_once)
    # It answers within 55 ms; where a mask meets its counter one pass after an answer, within 394 ms.
    confirm_ms: float = _setting(450.0, "a later confirmation is reported; a healthy board takes up to 394 ms (512 ms at its slowest)", (60, 2000))

    @property
    def outputs(self) -> tuple[int, ...]:
        """The servos on the board's outputs, in the outputs' order."""
        return self.servos or SERVO_IDS


FOR_STOPS: Final[Mapping[str, tuple[str, ...]]] = {
    "wire": ("name",),
    "spi": ("framing", "device", "speed_hz", "frame_gap_us"),
    "controller": ("uart",),
    "power": ("interface", "channel"),
}
"""The settings that a Stop needs. A fault elsewhere in a file must not prevent Stops."""

_IN_STATE: Final = "was removed; name its folder with state.path, the folder for all kept state"
REMOVED: Final[Mapping[Place, str]] = {
    ("calibration",): f"{_IN_STATE} (the calibration as calibration.toml)",
    ("recorder",): f"{_IN_STATE} (the black box keeps 60 s)",
    ("spi", "protocol"): "was removed; write its value as name in [wire]",
    ("spi", "batch"): "was removed; lists of transfers are written, and single ones where the kernel takes no lists",
    ("spi", "resync_ms"): "was removed; length-prefixed framing synchronises a stream once a second",
    ("spi", "avoid_deg"): "was removed; it follows from the framing",
    ("controller", "cycle_hz"): "was removed; the controller's cycle is 50 Hz",
    ("controller", "silent_ms"): "was removed; a controller is silent after 300 ms",
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
