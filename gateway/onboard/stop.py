"""`stop-servos`: the last resort. It must work at once, also when nothing else works."""

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gateway.errors import ConfigError, DeviceHeldError, GatewayError
from gateway.host import effective, realtime
from gateway.host.directories import CONFIGURATION
from gateway.host.effective import Effective
from gateway.host.settings_reader import ForStops
from gateway.host.settings_table import PowerSettings
from gateway.model.frames import STOP_REPEATS
from gateway.robot import settings
from gateway.robot.spi.stop_all import another_gateway_holds, stop_before_service
from gateway.robot.spi.stop_all import stop_servos as stop

if TYPE_CHECKING:
    from gateway.robot.power.last_cut import SupplyCut

_UNIT: Final = "hexapod-gateway.service"
_SYSTEMD: Final = Path("/run/systemd/system")
NOT_CONFIRMED: Final = 1
"""Exit code: all Stops are written, and the servos may still have their supply."""
_ANSWER_S: Final = 1.0
"""Limit for a systemd that hangs; otherwise it answers within 20 ms."""


def at_once(arguments: Sequence[str]) -> int | None:
    """Stop all six legs, and load only what this needs. Return the exit code of `stop-servos`.

    Return None, with nothing written, if the full command line is needed: for help, or wrong arguments.
    """
    realtime.prefer_process()
    realtime.prefer_thread(realtime.LOOP_PRIORITY)
    if not _is_plain(arguments):
        return None
    try:
        return 0 if run(_path(arguments)) else NOT_CONFIRMED
    except GatewayError as error:
        _say(*str(error).splitlines())
        return error.exit_code


def before_service(arguments: Sequence[str]) -> None:
    """Stop all six legs before `run` loads the service, which takes longer. Never raises.

    With options other than `--config` nothing is written. The service begins with Stops, too, and reports faults.
    """
    realtime.prefer_process()
    if _is_plain(arguments):
        with suppress(Exception):
            used = settings.load_for_stops(_path(arguments))
            with suppress(Exception):
                effective.write(used)  # before the first frame
            stop_before_service(used.wire, used.spi.within_limits()[0], used.controller)


def _is_plain(arguments: Sequence[str]) -> bool:
    return not arguments or (len(arguments) == 2 and arguments[0] == "--config")


def _path(arguments: Sequence[str]) -> Path | None:
    return Path(arguments[1]) if arguments else None


def run(path: Path | None) -> bool:
    """Stop all six legs with the service's settings, else with those of the file `path`, and cut their supply.

    Return False if the power board has not confirmed a cut that the settings want. Raises GatewayError.
    """
    chosen = _choose(path)
    if _is_anothers(chosen):
        _tell("no Stop is written: another gateway holds the device, and this service has moved nothing")
        return True
    kept = ""
    cut: SupplyCut | None = None
    try:
        cut = _cut(chosen.power)
    except Exception as error:  # no fault of the power board may prevent the Stops
        kept = f"the servos keep their supply ({error}): switch the power off by hand"
    try:
        stop_servos(chosen, (lambda: None) if cut is None else cut.stops_written.set)
    finally:
        off = not kept if cut is None else cut.end()
        if kept:  # after the Stops: they must not wait for a reader of stderr
            _say(kept)
    if isinstance(chosen, Effective) and not chosen.ended_here:  # the unit's file lacks the unit's variables
        _say(*(f"{each}; used the latter" for each in effective.differences(chosen, path or CONFIGURATION)))
    return off


def _is_anothers(chosen: ForStops) -> bool:
    """Return whether systemd runs this after a `run` that never had the device, which another gateway holds now.

    That `run` has written no frame that moves a servo. If its exit code or the holder is not certain, return False.
    """
    return (
        isinstance(chosen, Effective)
        and chosen.ended_here
        and os.environ.get("EXIT_STATUS") == str(DeviceHeldError.exit_code)
        and another_gateway_holds(chosen.wire, chosen.spi, chosen.controller)
    )


def _cut(power: PowerSettings | None) -> "SupplyCut | None":
    """Begin to cut the supply if the settings want that. Loads little, since the first Stops wait for this."""
    if power is None:
        raise ConfigError("[power] of the configuration is wrong")
    if power.interface in {"", "sim"}:
        return None
    from gateway.robot.power.last_cut import SupplyCut

    return SupplyCut(power, lambda sentence, confirmed: _tell(sentence) if confirmed else _say(sentence))


def _choose(path: Path | None) -> ForStops:
    """Return the settings to use: Effective if a service's. Raises ConfigError if neither it nor the file has any.

    The controller understands the service's settings, so these precede the file's. Another device that a person
    names, by a file or a variable, precedes both.
    """
    used, named = effective.read(), path is not None or bool(settings.overrides(os.environ))
    runs = used is not None and used.runs
    if used is not None and (used.ended_here or (runs and not named)):
        return used
    if not named:
        process, variables = unit()
        if used is not None and not process:  # nothing else has written to the controller since
            return used
        os.environ.update(variables)
    try:
        stated = settings.load_for_stops(path)
    except ConfigError:
        if used is None:
            raise
        return used
    same = used is not None and (stated.wire.name, stated.spi.device) == (used.wire.name, used.spi.device)
    return used if used is not None and runs and same else stated


def unit() -> tuple[int, dict[str, str]]:
    """Return the service's process id (0: none, or unknown), and its unit's variables that override `[spi]`,
    `[controller]` and `[power]` of a file."""
    if not _SYSTEMD.exists():
        return 0, {}
    import shlex
    import subprocess

    command = ["systemctl", "show", "--property=MainPID,Environment", _UNIT]
    try:
        shown = subprocess.run(command, capture_output=True, text=True, timeout=_ANSWER_S, check=True).stdout
        found = dict(line.partition("=")[::2] for line in shown.splitlines())
        variables = dict(each.partition("=")[::2] for each in shlex.split(found["Environment"]))
        return int(found["MainPID"]), settings.overrides(variables)
    except (OSError, ValueError, KeyError, subprocess.SubprocessError):
        return 0, {}


def stop_servos(used: ForStops, written: Callable[[], None]) -> None:
    """Stop all six legs, and print what was written. `written` is called after the Stops. Raises SpiError."""
    wire, (spi, changed) = used.wire, used.spi.within_limits()
    try:
        noticed = stop(wire, spi, used.controller, written)
    finally:  # after the Stops: they must not wait for a reader of stderr
        if changed:
            _say(changed)
    times = 1 + STOP_REPEATS
    device = spi.device if wire.framed else wire.name
    lines = [f"Stop written to all six legs, {times} times each, on {device}"]
    if wire.has_uart:
        lines = [f"shutdown of all servos written {times} times, on {used.controller.uart}"]
    if noticed is not None:
        lines.append(_NOTICED if noticed else _NOT_NOTICED)
    _tell(*lines)


def _tell(*lines: str) -> None:
    sys.stdout.write("\n".join([*lines, ""]))
    sys.stdout.flush()


def _say(*lines: str) -> None:
    sys.stderr.writelines(f"hexapod-gateway: {line}\n" for line in lines)


_NOTICED: Final = "The running gateway counts all servos as stopped; they move again when somebody starts them."
_NOT_NOTICED: Final = (
    "The gateway that holds the device has not noticed: it may hang, and its state may show running servos."
)
