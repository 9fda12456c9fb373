"""`stop-servos`: the last resort. It must work at once, and when nothing else does."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from gateway.errors import ConfigError, GatewayError
from gateway.host import effective, plain_settings, realtime
from gateway.host.effective import Effective
from gateway.host.plain_settings import DEFAULT_PATH, ControllerValues, RepeatValues, SpiValues
from gateway.model.protocols import SpiProtocol
from gateway.robot.spi.stop_all import stop_servos as stop

_UNIT: Final = "hexapod-gateway.service"
_SYSTEMD: Final = Path("/run/systemd/system")
_ANSWER_S: Final = 1.0
"""A systemd that hangs is not waited for any longer; it answers within 20 ms."""


def at_once(arguments: Sequence[str]) -> int | None:
    """Stop all six legs, with little more loaded than writes the Stops: the exit code, as of `stop-servos`.

    None where that takes more: help, or a mistake among the arguments, and nothing is written then.
    """
    realtime.prefer_process()
    realtime.prefer_thread(realtime.LOOP_PRIORITY)
    match arguments:
        case []:
            path = None
        case ["--config", name]:
            path = Path(name)
        case _:
            return None
    try:
        run(path)
    except GatewayError as error:
        _say(*str(error).splitlines())
        return error.exit_code
    return 0


def run(path: Path | None) -> None:
    """Stop all six legs with the settings that the service uses, else with those of the file. Raises GatewayError."""
    chosen = _choose(path)
    stop_servos(chosen.spi, chosen.watchdog, chosen.controller)
    if chosen.used is not None and not chosen.used.ended_here:  # the unit's file lacks the unit's variables
        _say(*(f"{each}; used the latter" for each in effective.differences(chosen.used, path or DEFAULT_PATH)))


class _Chosen(NamedTuple):
    spi: SpiValues
    watchdog: RepeatValues
    controller: ControllerValues
    used: Effective | None = None
    """The service whose settings these are; None: a file's."""


def _choose(path: Path | None) -> _Chosen:
    """The settings to use. Raises ConfigError only where neither a service nor the file has any.

    The controller understands what the service uses, so that goes before the file. A person who names another device,
    by a file or a variable, means that one.
    """
    used = effective.read()
    theirs = None if used is None else _Chosen(used.spi, used.watchdog, used.controller, used)
    named = path is not None or bool(plain_settings.overrides(os.environ))
    runs = used is not None and used.runs
    if theirs is not None and used is not None and (used.ended_here or (runs and not named)):
        return theirs
    if not named:
        process, variables = unit()
        if theirs is not None and not process:  # nothing else has spoken to the controller since
            return theirs
        os.environ.update(variables)
    try:
        stated = _of_file(path)
    except ConfigError:
        if theirs is None:
            raise
        return theirs
    return theirs if theirs is not None and runs and stated.spi.device == theirs.spi.device else stated


def _of_file(path: Path | None) -> _Chosen:
    plain = plain_settings.read(path or DEFAULT_PATH)
    if plain is not None:
        return _Chosen(*plain)
    from gateway.robot import settings  # slow: it takes longer than all Stops

    found = settings.load(path, for_stops=True)
    return _Chosen(found.spi, found.watchdog, found.controller)


def unit() -> tuple[int, dict[str, str]]:
    """The service's process (0: none, or not known), and its unit's variables that override a file: those of `[spi]`,
    `[watchdog]` and `[controller]`."""
    if not _SYSTEMD.exists():
        return 0, {}
    import shlex
    import subprocess

    command = ["systemctl", "show", "--property=MainPID,Environment", _UNIT]
    try:
        shown = subprocess.run(command, capture_output=True, text=True, timeout=_ANSWER_S, check=True).stdout
        found = dict(line.partition("=")[::2] for line in shown.splitlines())
        variables = dict(each.partition("=")[::2] for each in shlex.split(found["Environment"]))
        return int(found["MainPID"]), plain_settings.overrides(variables)
    except (OSError, ValueError, KeyError, subprocess.SubprocessError):
        return 0, {}


def stop_servos(spi: SpiValues, watchdog: RepeatValues, controller: ControllerValues) -> None:
    """Stop all six legs. Raises SpiError."""
    spi, changed = plain_settings.within_limits(spi)
    try:
        noticed = stop(spi, watchdog, controller)
    finally:  # after the Stops, which wait for nobody who reads this
        if changed:
            _say(changed)
    times = 1 + watchdog.repeats
    lines = [f"Stop written to all six legs, {times} times each, on {spi.device}"]
    if spi.protocol is SpiProtocol.ELKAPOD_2025:
        lines = [f"shutdown of all servos written {times} times, on {controller.uart}"]
    if noticed is not None:
        lines.append(_NOTICED if noticed else _NOT_NOTICED)
    sys.stdout.write("\n".join([*lines, ""]))
    sys.stdout.flush()


def _say(*lines: str) -> None:
    sys.stderr.writelines(f"hexapod-gateway: {line}\n" for line in lines)


_NOTICED: Final = "The running gateway counts all servos as stopped; they move again when somebody starts them."
_NOT_NOTICED: Final = (
    "The gateway that holds the device has not noticed: it may hang, and its state may show running servos."
)
