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

from gateway import __version__, own_command
from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.directories import CONFIGURATION
from gateway.host.effective import Effective
from gateway.model.black_box.files import RING_FILE
from gateway.onboard import stop
from gateway.onboard.check import certificates, installation, laptop, machine, network, service_user, table, wire
from gateway.onboard.check.table import CheckedRobot, Probe, Result, Seen, Verdict, judged, results, warning
from gateway.people.terminal import clear_line, rows, say, show_line
from gateway.robot import settings as settings_file
from gateway.robot.blackbox import paths
from gateway.robot.settings import FramingNotSetError, Settings
from gateway.robot.zenoh_io.session import service_config
from gateway.zenoh_config import listen_endpoints
from schemas.telemetry import GatewayState, Mode

_STYLES: Final = {Verdict.OK: rows.GOOD, Verdict.WARNING: rows.NOTE, Verdict.FAILURE: rows.BAD}
_STATE_IT: Final = (
    "state in the file what the controller needs, and take the variable out (systemctl cat hexapod-gateway)"
)
_RUNS: Final = "{version} runs on a simulated controller, and is {mode}"
# fmt: off
SIMULATED: Final = (
    Probe("gateway", lambda seen: seen, (
        warning(lambda r: r.version != r.own, f"{_RUNS}; this program is {{own}}", "end it, and start it again"),
        warning(lambda r: r.mode == Mode.ESTOPPED, _RUNS, "{run[reset]} leaves the emergency stop"),
        warning(lambda r: not r.frames, f"{_RUNS}, without frames to record", "set telemetry.frames = true"),
    ), f"{_RUNS}. For a real robot, end it and check again"),
    Probe("black box", lambda seen: seen, (
        warning(lambda r: not r.keeps, "is off", "`make run` keeps one; for another gateway set state.path"),
    ), "{folder}; hexapod-gateway incidents shows what it kept"),
)
CONFIGURED: Final = (
    *wire.PROBES, *certificates.CERTIFICATES, network.ZENOH, network.ACCESS, network.PORTS, *wire.POWER,
)
# fmt: on
"""What depends on the settings."""


def check(config: Path | None, *, as_json: bool = False) -> int:
    """Print every check's line as it is known; the exit code: 0, or 1 after a failure.

    As root, each is looked at as the service's user. Where a gateway with a simulated controller runs, and no file is
    named, that is looked at.
    Raises ConfigError where oneself may not read the configuration, and FramingNotSetError: what the machine can do
    matters only once it is known what the controller understands.
    """
    robot = CheckedRobot()
    show_line("reading the files of the installed release …")
    seen = list(results(installation.PROBES, robot)) if robot.installed else []  # root sees it all
    clear_line()
    service_user.go_on_as(robot.unit.get("LimitRTPRIO", ""))
    found = _simulated() if config is None else None
    if found is None:
        return _report(run(config, robot, seen), "This machine", "run the service", as_json=as_json)
    return _report(chain(_beside(*found), seen), "The simulated robot", "be driven", as_json=as_json)


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
    passed = not count[Verdict.FAILURE]
    if as_json:
        say(json.dumps({"passed": passed, "checks": [each._asdict() for each in lines.values()]}))
        return 0 if passed else 1
    worst = Verdict.WARNING if passed else Verdict.FAILURE
    many = f"{count[worst]} {worst}{'s' * (count[worst] != 1)}"
    end = f"can {can}{f', with {many}' if count[worst] else ''}" if passed else f"cannot {can}: {many}"
    return rows.conclude(f"{what} {end}.", well=passed)


def run(config: Path | None, robot: CheckedRobot, seen: Sequence[Result]) -> Iterator[Result]:
    """All checks, in order; those of the settings only where these can be read. Raises FramingNotSetError at once.

    While the service runs, and no file is named, its device is looked at with the settings that it uses.
    """
    path = config or CONFIGURATION
    if os.geteuid() not in (0, service_user.uid()) and _denied(path):
        raise ConfigError(f"{path} is not for you to read, as it may name keys: sudo hexapod-gateway check")
    used = effective.read() if config is None else None
    used = used if used is not None and used.runs else None
    settings, faults = None, list[str]()
    in_unit = used is not None and "HEXAPOD_SPI__FRAMING" in map(str.upper, stop.unit()[1])
    try:
        settings = settings_file.load(config, simulated=in_unit)
    except ConfigError as error:
        if isinstance(error, FramingNotSetError) and used is None:  # else it runs, and would not start again
            raise
        faults = str(error).splitlines()
    robot.settings = settings or robot.settings
    yield from results([machine.PYTHON, machine.USER], robot)
    yield from seen
    for fault in faults:
        fix = table.LET_READ if certificates.DENIED in fault else "fix it there, and check again"
        yield Result("configuration", Verdict.FAILURE, fault, fix)
    if settings is None:
        rest = "device, ports and certificates were not looked at"
        yield Result("the rest", Verdict.WARNING, rest, "fix the configuration first")
    else:
        where = str(path) if path.exists() else f"the defaults, since there is no {path}"
        yield Result("configuration", Verdict.OK, where)
        yield from _in_use(robot, used, path)
        yield from results(CONFIGURED, robot)
    yield from results([machine.CLOCK, installation.UNIT, *machine.MACHINE], robot)


def _denied(path: Path) -> bool:
    with suppress(FileNotFoundError, IsADirectoryError, NotADirectoryError):
        try:
            path.open("rb").close()
        except PermissionError:
            return True
    return False


def _in_use(robot: CheckedRobot, used: Effective | None, path: Path) -> Iterator[Result]:
    """Where the service uses other settings than the file's; the wire is looked at with the service's."""
    if used is not None:
        stated = robot.settings
        uart = replace(stated.controller, uart=used.controller.uart)
        if stated.spi.device != used.spi.device:
            yield from results([wire.DEVICE], robot)
        robot.settings = replace(stated, spi=used.spi, controller=uart)
        for each in effective.differences(used, path):
            yield Result("in use", Verdict.WARNING, each, _STATE_IT)


# ---- a gateway with a simulated controller, as `make run` starts it: it needs neither device nor framing


def _simulated() -> tuple[Settings, GatewayState] | None:
    """The settings that are found without a file named, and what answers there; None: no simulated gateway does."""
    with suppress(ConfigError):
        settings = settings_file.load(None, simulated=True)
        for endpoint in listen_endpoints(service_config(settings.zenoh)):
            if endpoint.startswith("tcp/") and (state := network.state_at(endpoint)) is not None and state.simulated:
                own_command.reach_by(connect=endpoint)
                return settings, state
    return None


def _beside(settings: Settings, state: GatewayState) -> Iterator[Result]:
    robot, folder = CheckedRobot(settings, gateway_runs=True), paths.folder_to_read(settings)
    seen = Seen(version=state.version, own=__version__, mode=state.mode, folder=folder, frames=state.telemetry.frames)
    seen.keeps = folder is not None and (folder / RING_FILE).exists()
    yield from results([machine.PYTHON], robot)
    yield from chain.from_iterable(judged(probe, seen) for probe in SIMULATED)
    yield from results([wire.CALIBRATION[0], certificates.CERTIFICATES[0], network.PORTS, machine.CLOCK], robot)
