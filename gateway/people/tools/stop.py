"""`stop-servos`: the last resort. It must work at once, and when nothing else does."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from gateway.errors import GatewayError
from gateway.robot.host import realtime
from gateway.robot.spi import plain_settings
from gateway.robot.spi.plain_settings import RepeatValues, SpiValues
from gateway.robot.spi.stop_all import stop_servos as stop


def at_once(arguments: Sequence[str]) -> int | None:
    """Stop all six legs, with little more loaded than writes the Stops: the exit code, as of `stop-servos`.

    None where that takes more: help, a mistake among the arguments or in the settings, and nothing is written then.
    """
    realtime.prefer_process()
    realtime.prefer_thread(realtime.LOOP_PRIORITY)
    match arguments:
        case []:
            path = plain_settings.DEFAULT_PATH
        case ["--config", name]:
            path = Path(name)
        case _:
            return None
    settings = plain_settings.read(path)
    if settings is None:
        return None
    try:
        stop_servos(*settings)
    except GatewayError as error:
        sys.stderr.write(f"hexapod-gateway: {error}\n")
        return error.exit_code
    return 0


def stop_servos(spi: SpiValues, watchdog: RepeatValues) -> None:
    """Stop all six legs over SPI. Raises SpiError."""
    spi, changed = plain_settings.within_limits(spi)
    try:
        noticed = stop(spi, watchdog)
    finally:  # after the Stops, which wait for nobody who reads this
        if changed:
            sys.stderr.write(f"hexapod-gateway: {changed}\n")
    lines = [f"Stop written to all six legs, {1 + watchdog.repeats} times each, on {spi.device}"]
    if noticed is not None:
        lines.append(_NOTICED if noticed else _NOT_NOTICED)
    sys.stdout.write("\n".join([*lines, ""]))
    sys.stdout.flush()


_NOTICED: Final = "The running gateway counts all servos as stopped; they move again when somebody starts them."
_NOT_NOTICED: Final = (
    "The gateway that holds the device has not noticed: it may hang, and its state may say that servos run."
)
