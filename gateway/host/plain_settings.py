"""The settings of `stop-servos`, read without pydantic: to load that and its models takes longer than all Stops.

Only what is plainly right is read here: known names, values of the right type and within their limits. Anything else is
for `gateway.robot.settings`, whose defaults and limits these are (`tests/unit/robot/test_plain_settings.py`). What the
framing allows beyond these limits is no reason to write no Stop, see `within_limits`.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Union

from gateway.robot.protocol.framing import Framing

from gateway import nesting

if TYPE_CHECKING:
    from gateway.robot.settings import SpiSettings, WatchdogSettings

DEFAULT_PATH: Final = Path("/etc/hexapod-gateway/gateway.toml")
_OVERRIDES: Final = ("HEXAPOD_SPI__", "HEXAPOD_WATCHDOG__")


class PlainSpi(NamedTuple):
    """The table [spi]."""

    framing: Framing
    device: str = "/dev/spidev0.0"
    batch: bool = True
    speed_hz: int = 2_500_000
    frame_gap_us: float = 50.0
    resync_ms: float = 1000.0

    @property
    def avoid_cdeg(self) -> None:
        """A Stop has no angle."""


class PlainRepeats(NamedTuple):
    """Of the table [watchdog]."""

    repeats: int = 3
    repeat_interval_ms: float = 20.0


SpiValues = Union["SpiSettings", PlainSpi]
RepeatValues = Union["WatchdogSettings", PlainRepeats]

LIMITS: Final[Mapping[str, tuple[float, float]]] = {
    "speed_hz": (1, 20_000_000),
    "frame_gap_us": (0, 1000),
    "resync_ms": (0, 10_000),
    "repeats": (0, 100),
    "repeat_interval_ms": (1, 1000),
}
NOT_FOR_STOPS: Final = frozenset({"avoid_deg"})
"""Settings of [spi] that no Stop depends on; they are not looked at."""
_WHOLE: Final = frozenset({"speed_hz", "repeats"})

_KNOWN: Final = NOT_FOR_STOPS | set(PlainSpi._fields)


def read(path: Path) -> tuple[PlainSpi, PlainRepeats] | None:
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


def of(tables: Mapping[str, Any]) -> tuple[PlainSpi, PlainRepeats] | None:
    """What a file's tables say; None where anything of it is not plainly right."""
    spi, watchdog = tables.get("spi"), tables.get("watchdog", {})
    if not isinstance(spi, dict) or not isinstance(watchdog, dict) or not spi.keys() <= _KNOWN:
        return None
    spi = {name: value for name, value in spi.items() if name not in NOT_FOR_STOPS}
    of_watchdog = {name: watchdog[name] for name in PlainRepeats._fields if name in watchdog}
    if not all(_is_right(name, value) for name, value in (spi | of_watchdog).items()):
        return None
    if spi.get("framing") not in set(Framing):
        return None
    return PlainSpi(**(spi | {"framing": Framing(spi["framing"])})), PlainRepeats(**of_watchdog)


def within_limits(spi: SpiValues) -> tuple[SpiValues, str]:
    """These, with the clock and the pause that their framing allows, and a sentence; it is empty if they were.

    The service rejects what this changes. The last means of stopping must not fail for it, nor lose Stops by it.
    """
    framing = spi.framing
    fault = framing.too_fast(spi.speed_hz, spi.frame_gap_us)
    if not fault:
        return spi, ""
    speed_hz, gap_us = min(spi.speed_hz, framing.most_hz), max(spi.frame_gap_us, framing.least_gap_us)
    plain = PlainSpi(framing, spi.device, spi.batch, speed_hz, gap_us, spi.resync_ms)
    return plain, f"spi: {fault}; stop-servos uses {speed_hz} Hz and {gap_us:g} µs"


def _is_right(name: str, value: Any) -> bool:
    if name in {"device", "framing"}:
        return isinstance(value, str) and (name == "framing" or (value.startswith("/") and "\0" not in value))
    if name == "batch":
        return isinstance(value, bool)
    low, high = LIMITS[name]
    known = isinstance(value, int if name in _WHOLE else int | float) and not isinstance(value, bool)
    return known and low <= value <= high
