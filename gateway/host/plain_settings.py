"""The settings of `stop-servos`, read without pydantic: to load that and its models takes longer than all Stops.

Only what is plainly right is read here: known names, values of the right type and within their limits. Anything else is
for `gateway.robot.settings`, whose defaults and limits these are (`tests/unit/host/test_plain_settings.py`). What the
framing allows beyond these limits is no reason to write no Stop, see `within_limits`.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

from gateway import nesting
from gateway.model.framing import Framing
from gateway.model.protocols import SpiProtocol

DEFAULT_PATH: Final = Path("/etc/hexapod-gateway/gateway.toml")
_OVERRIDES: Final = ("HEXAPOD_SPI__", "HEXAPOD_CONTROLLER__", "HEXAPOD_POWER__")


class PlainSpi(NamedTuple):
    """The table [spi]."""

    framing: Framing = Framing.PLAIN
    protocol: SpiProtocol = SpiProtocol.HEXAPOD_1_0
    device: str = "/dev/spidev0.0"
    speed_hz: int = SpiProtocol.HEXAPOD_1_0.speed_hz
    frame_gap_us: float = 50.0

    @property
    def avoid_cdeg(self) -> None:
        """A Stop has no angle."""


class PlainController(NamedTuple):
    """Of the table [controller]."""

    uart: str = "/dev/ttyAMA1"


class PlainPower(NamedTuple):
    """Of the table [power]."""

    interface: str = ""
    channel: str = "can0"


class SpiValues(Protocol):
    """The table [spi], as `PlainSpi` or as the service has it."""

    @property
    def protocol(self) -> SpiProtocol: ...
    @property
    def framing(self) -> Framing: ...
    @property
    def device(self) -> str: ...
    @property
    def speed_hz(self) -> int: ...
    @property
    def frame_gap_us(self) -> float: ...
    @property
    def avoid_cdeg(self) -> tuple[int, int] | None: ...


class ControllerValues(Protocol):
    """The table [controller], as `PlainController` or as the service has it."""

    @property
    def uart(self) -> str: ...


class PowerValues(Protocol):
    """The table [power], as `PlainPower` or as the service has it."""

    @property
    def interface(self) -> str: ...
    @property
    def channel(self) -> str: ...


class Plain(NamedTuple):
    """What a Stop needs of a file."""

    spi: PlainSpi
    controller: PlainController
    power: PlainPower | None
    """None: it is not plainly right, which is no reason to write no Stop."""


LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    "speed_hz": (1, 20_000_000),
    "frame_gap_us": (0, 1000),
}
REMOVED: Final = frozenset({"avoid_deg", "batch", "resync_ms"})
"""Settings of [spi] in files of earlier versions, which must not prevent a Stop; they are not looked at."""

_KNOWN: Final = REMOVED | set(PlainSpi._fields)


def read(path: Path) -> Plain | None:
    """What the file says; None where anything of it is not plainly right, or a variable overrides it."""
    if overrides(os.environ):
        return None
    try:
        with path.open("rb") as file:
            return of(nesting.read_toml(file.read(nesting.MOST_BYTES + 1)))
    except (OSError, ValueError):
        return None


def overrides(variables: Mapping[str, str]) -> dict[str, str]:
    """Those that override what a file says of this."""
    return {name: value for name, value in variables.items() if name.upper().startswith(_OVERRIDES)}


def of(tables: Mapping[str, Any]) -> Plain | None:
    """What a file's tables say; None where anything of it is not plainly right."""
    spi, controller = tables.get("spi"), tables.get("controller", {})
    if not (isinstance(spi, dict) and isinstance(controller, dict)):
        return None
    if not spi.keys() <= _KNOWN:
        return None
    spi = {name: value for name, value in spi.items() if name not in REMOVED}
    of_controller = {name: controller[name] for name in PlainController._fields if name in controller}
    if not all(_is_right(name, value) for name, value in (spi | of_controller).items()):
        return None
    protocol = spi.get("protocol", SpiProtocol.HEXAPOD_1_0)
    framing = spi.get("framing", None if protocol == SpiProtocol.HEXAPOD_1_0 else Framing.PLAIN)
    if protocol not in set(SpiProtocol) or framing not in set(Framing):
        return None
    known = {"protocol": SpiProtocol(protocol), "framing": Framing(framing)}
    stated = {"speed_hz": SpiProtocol(protocol).speed_hz} | spi | known
    power = _power(tables.get("power", {}))
    return Plain(PlainSpi(**stated), PlainController(**of_controller), power)


def _power(table: Any) -> PlainPower | None:
    if not isinstance(table, dict):
        return None
    stated: dict[str, Any] = {name: table[name] for name in PlainPower._fields if name in table}
    if not all(_is_right(name, value) for name, value in stated.items()):
        return None
    return PlainPower(**stated)


def within_limits(spi: SpiValues) -> tuple[SpiValues, str]:
    """These, with the clock and the pause that their framing allows, and a sentence; it is empty if they were.

    The service rejects what this changes. The last means of stopping must not fail for it, nor lose Stops by it.
    """
    framing = spi.framing
    fault = framing.too_fast(spi.speed_hz, spi.frame_gap_us)
    if not fault or spi.protocol is not SpiProtocol.HEXAPOD_1_0:
        return spi, ""
    speed_hz, gap_us = min(spi.speed_hz, framing.most_hz), max(spi.frame_gap_us, framing.least_gap_us)
    plain = PlainSpi(framing, spi.protocol, spi.device, speed_hz, gap_us)
    return plain, f"spi: {fault}; stop-servos uses {speed_hz} Hz and {gap_us:g} µs"


def _is_right(name: str, value: Any) -> bool:
    if name in {"protocol", "framing", "interface", "channel"}:
        return isinstance(value, str) and "\0" not in value
    if name in {"device", "uart"}:
        return isinstance(value, str) and value.startswith("/") and "\0" not in value
    low, high = LIMITS[name]
    known = isinstance(value, int if name == "speed_hz" else int | float) and not isinstance(value, bool)
    return known and low <= value <= high
