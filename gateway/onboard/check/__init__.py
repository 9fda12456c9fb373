"""`hexapod-gateway check`: what is missing on this machine to run the service, a line each, and how to fix it.

It changes nothing: no byte reaches the robot, and a running gateway is not disturbed. A power board is asked.
"""

import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.effective import Effective
from gateway.onboard import stop
from gateway.onboard.check import (
    certificates,
    controller,
    device,
    installation,
    laptop,
    machine,
    network,
    power,
    service_user,
    simulated,
)  # fmt: skip
from gateway.onboard.check.table import LET_READ, CheckedRobot, Result, Verdict, results
from gateway.people.terminal import clear_line, rows, say, show_line
from gateway.robot import settings as settings_file
from gateway.robot.sections import SpiSettings
from gateway.robot.settings import FramingNotSetError, Settings

_STYLES: Final = {Verdict.OK: rows.GOOD, Verdict.WARNING: rows.NOTE, Verdict.FAILURE: rows.BAD}
_FRAMING: Final = "hexapod_spi__framing"
_STATE_IT: Final = (
    "state in the file what the controller needs, and take the variable out (systemctl cat hexapod-gateway)"
)


def check(config: Path | None, *, as_json: bool = False) -> int:
    """Print every check's line as it is known; the exit code: 0, or 1 after a failure.

    As root, each is looked at as the service's user. Where a gateway with a simulated controller runs, and no file is
    named, that is looked at.
    Raises ConfigError where oneself may not read the configuration, and FramingNotSetError: what the machine can do
    matters only once it is known what the controller understands.
    """
    runs = machine.running_release(machine.main_process())  # only root may see it
    show_line("reading the files of the installed release …")
    seen = installation.look()  # root sees it all
    clear_line()

    def look() -> int:
        found = simulated.found() if config is None else None
        lines = run(config, seen) if found is None else chain(simulated.look(*found), seen or ())
        what, can = ("This machine", "run the service") if found is None else ("The simulated robot", "be driven")
        return _report(chain(lines, results([machine.RELEASE], runs)), what, can, as_json=as_json)

    return service_user.run(look, machine.granted_rtprio())


def check_laptop(connect: str | None, zenoh_config: Path | None, timeout_s: float, *, as_json: bool = False) -> int:
    """The same of a laptop: whether it reaches the robot, and what it may do there."""
    steps = laptop.checks(connect, zenoh_config, timeout_s)
    return _report(steps, "This machine", "reach the gateway", as_json=as_json)


def _report(found: Iterable[Result], what: str, can: str, *, as_json: bool) -> int:
    """Print the lines, each sentence once, and one at the end."""
    lines = dict[str, Result]()
    for result in found:
        if result.sentence not in lines and not as_json:
            rows.show(rows.row(result.verdict, _STYLES[result.verdict], result.name, result.sentence, result.fix))
        lines.setdefault(result.sentence, result)
    count = Counter(each.verdict for each in lines.values())
    failures, warnings = (
        f"{count[each]} {each}{'s' * (count[each] != 1)}" for each in (Verdict.FAILURE, Verdict.WARNING)
    )
    if as_json:
        passed = not count[Verdict.FAILURE]
        say(json.dumps({"passed": passed, "checks": [each._asdict() for each in lines.values()]}))
        return 0 if passed else 1
    if count[Verdict.FAILURE]:
        return rows.conclude(f"{what} cannot {can}: {failures}.", well=False)
    remark = f", with {warnings}" if count[Verdict.WARNING] else ""
    return rows.conclude(f"{what} can {can}{remark}.", well=True)


def run(config: Path | None, seen: Sequence[Result] | None = None) -> Iterator[Result]:
    """All checks, in order; those of the settings only where these can be read. Raises FramingNotSetError at once.

    While the service runs, and no file is named, its device is looked at with the settings that it uses.
    """
    path = config or settings_file.DEFAULT_PATH
    if os.geteuid() not in (0, service_user.uid()) and _denied(path):
        raise ConfigError(f"{path} is not for you to read, as it may name keys: sudo hexapod-gateway check")
    used = effective.read() if config is None else None
    used = used if used is not None and used.runs else None
    stated_in_unit = used is not None and any(name.lower() == _FRAMING for name in stop.unit()[1])
    settings: Settings | None = None
    faults: list[str] = []
    try:
        settings = settings_file.load(config, simulated=stated_in_unit)
    except ConfigError as error:
        if isinstance(error, FramingNotSetError) and used is None:  # else it runs, and would not start again
            raise
        faults = str(error).splitlines()
    robot = CheckedRobot(settings or Settings(), installed=seen is not None)
    yield from results([machine.PYTHON, machine.USER], robot)
    yield from seen or ()
    for fault in faults:
        fix = LET_READ if certificates.DENIED in fault else "fix it there, and check again"
        yield Result("configuration", Verdict.FAILURE, fault, fix)
    if settings is None:
        what = "device, ports and certificates were not looked at"
        yield Result("the rest", Verdict.WARNING, what, "fix the configuration first")
    else:
        where = str(path) if path.exists() else f"the defaults, since there is no {path}"
        yield Result("configuration", Verdict.OK, where)
        yield from _of_settings(robot, used, path)
    probes = (machine.CLOCK, machine.GOVERNOR, machine.VOLTAGE, machine.MEMORY, machine.UNIT, machine.REALTIME)
    yield from results(probes, robot)


def _denied(path: Path) -> bool:
    with suppress(FileNotFoundError, IsADirectoryError, NotADirectoryError):
        try:
            path.open("rb").close()
        except PermissionError:
            return True
    return False


def _of_settings(robot: CheckedRobot, used: Effective | None, path: Path) -> Iterator[Result]:
    if used is not None:  # the wire is the one that the service uses
        stated = robot.settings
        uart = stated.controller.model_copy(update={"uart": used.controller.uart})
        spi = SpiSettings.model_validate(used.tables["spi"])
        robot = replace(robot, settings=stated.model_copy(update={"spi": spi, "controller": uart}))
        if stated.spi.device != spi.device:
            yield from results([device.DEVICE], CheckedRobot(stated))
        for each in effective.differences(used, path):
            yield Result("in use", Verdict.WARNING, each, _STATE_IT)
    probes = (
        device.DEVICE,
        *device.BUS,
        *controller.CONTROLLER,
        *device.FRAMES,
        *device.CALIBRATION,
        *certificates.CERTIFICATES,
        network.ZENOH,
        network.ACCESS,
        network.PORTS,
        power.BOARD,
    )
    yield from results(probes, robot)
