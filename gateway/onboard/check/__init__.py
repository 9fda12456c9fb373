"""`hexapod-gateway check`: what this machine lacks to run the service, a line each, and how to fix it.

It changes nothing: no byte reaches the robot, and a running gateway is not disturbed. With elkapod-2025 and no gateway
running, a controller whose heartbeat comes is shut down, since its answers need frames. A power board is asked.
"""

import datetime as dt
import os
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError
from gateway.host import effective
from gateway.host.directories import state_to_read
from gateway.onboard import stop
from gateway.onboard.check import (
    access,
    calibration,
    controller,
    device,
    holders,
    installation,
    laptop,
    looking,
    machine,
    network,
    power,
    release,
    running,
    service_user,
    spi_bus,
    trust,
)
from gateway.onboard.check.result import Result, Verdict, failure, ok, warning
from gateway.people.terminal import clear_line, rows, show_line
from gateway.robot import settings as settings_file
from gateway.robot.sections import SpiSettings
from gateway.robot.settings import FramingNotSetError, Settings
from gateway.zenoh_config import listen_endpoints

_STYLES: Final = {Verdict.OK: rows.GOOD, Verdict.WARNING: rows.NOTE, Verdict.FAILURE: rows.BAD}


def check(config: Path | None) -> int:
    """Print every check's line as it is known; the exit code: 0, or 1 after a failure.

    As root, each is looked at as the service's user. Where a gateway with a simulated controller runs, and no file is
    named, that is looked at.
    Raises ConfigError where oneself may not read the configuration, and FramingNotSetError: what the machine can do
    matters only once it is known what the controller understands.
    """
    runs = release.running(machine.main_process())  # only root may see it
    show_line("reading the files of the installed release …")
    seen = looking.look()  # root sees it all
    clear_line()

    def look() -> int:
        found = running.simulated() if config is None else None
        if found is not None:
            results = chain(running.results(*found), _installed(seen), release.findings(runs))
            return _report(results, "The simulated robot is well", "The simulated robot is not well")
        results = chain(run(config, seen), release.findings(runs))
        return _report(results, "This machine can run the service", "This machine cannot run the service")

    return service_user.run(look, machine.granted_rtprio())


def check_laptop(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> int:
    """The same of a laptop: whether it reaches the robot, and what it may do there."""
    steps = laptop.checks(connect, zenoh_config, timeout_s)
    return _report(steps, "This machine reaches the gateway", "This machine does not reach the gateway")


def _report(found: Iterable[Result], well: str, unwell: str) -> int:
    count = Counter[Verdict]()
    for result in found:
        count[result.verdict] += 1
        rows.show(rows.row(result.verdict, _STYLES[result.verdict], result.name, result.sentence, result.fix))
    failures, warnings = count[Verdict.FAILURE], count[Verdict.WARNING]
    if failures:
        return rows.conclude(f"{unwell}: {_count(failures, 'failure')}.", well=False)
    remark = f", with {_count(warnings, 'warning')}" if warnings else ""
    return rows.conclude(f"{well}{remark}.", well=True)


def run(config: Path | None, seen: installation.Installation | None = None) -> Iterator[Result]:
    """All checks, in order; those of the settings only where these can be read. Raises FramingNotSetError at once.

    While the service runs, and no file is named, its device is looked at with the settings that it uses.
    """
    path = config or settings_file.DEFAULT_PATH
    if os.geteuid() not in (0, service_user.uid()) and _denied(path):
        raise ConfigError(f"{path} is not for you to read, as it may name keys: sudo hexapod-gateway check")
    used = effective.read() if config is None else None
    used = used if used is not None and used.runs else None
    stated_in_unit = used is not None and any(name.lower() == _FRAMING for name in stop.unit()[1])
    try:
        settings: Settings | ConfigError = settings_file.load(config, simulated=stated_in_unit)
    except FramingNotSetError as error:
        if used is None:
            raise
        settings = error  # the service runs, and would not start again
    except ConfigError as error:
        settings = error
    yield machine.python()
    whose = service_user.who()
    if whose is not None:
        yield whose
    yield from _installed(seen)
    if isinstance(settings, ConfigError):
        yield from _unreadable(settings)
    else:
        yield _configuration(config)
        if used is not None:
            if settings.spi.device != used.spi.device:
                yield device.device(settings.spi)
            yield from (warning("in use", each, _STATE_IT) for each in effective.differences(used, path))
            uart = settings.controller.model_copy(update={"uart": used.controller.uart})
            spi = SpiSettings.model_validate(used.tables["spi"])
            settings = settings.model_copy(update={"spi": spi, "controller": uart})
        yield from _of_settings(settings)
    yield machine.clock()
    unit = machine.unit()
    if seen is None or not machine.is_no_unit(unit):  # the installation's row has it, and the fix
        yield unit
    yield machine.running_realtime() or machine.realtime()


def _installed(seen: installation.Installation | None) -> Iterator[Result]:
    """Nothing where the service is not installed."""
    if seen is not None:
        yield from list(installation.results(seen)) or [ok("installation", f"{seen.release}, each file as installed")]


def _unreadable(error: ConfigError) -> Iterator[Result]:
    for fault in str(error).splitlines():
        yield failure("configuration", fault, trust.LET_READ if network.DENIED in fault else _FIX_IT)
    yield warning("the rest", "device, ports and certificates were not looked at", "fix the configuration first")


def _denied(path: Path) -> bool:
    try:
        path.open("rb").close()
    except PermissionError:
        return True
    except OSError:
        return False
    return False


_FRAMING: Final = "hexapod_spi__framing"
_FIX_IT: Final = "fix it there, and check again"
_STATE_IT: Final = (
    "state in the file what the controller needs, and take the variable out (systemctl cat hexapod-gateway)"
)


def _configuration(config: Path | None) -> Result:
    path = config or settings_file.DEFAULT_PATH
    return ok("configuration", str(path) if path.exists() else f"the defaults, since there is no {path}")


def _of_settings(settings: Settings) -> Iterator[Result]:
    path = settings.spi.device
    spi_device = device.device(settings.spi)
    yield spi_device
    kernel_hz = device.kernel_hz(path) if spi_device.verdict is Verdict.OK else None
    yield spi_bus.carrier(path)
    yield spi_bus.shared(path)
    yield device.speed(settings.spi, kernel_hz=kernel_hz, gateway_runs=device.held(spi_device))
    if settings.spi.protocol.measures:
        yield from controller.results(settings, gateway_runs=device.held(spi_device))
    else:
        yield device.framing(settings.spi)
        yield device.lists(settings.spi)
    kept = calibration.kept(settings)
    yield kept
    if kept.verdict is not Verdict.FAILURE and "not for you" not in kept.sentence:
        yield from calibration.landing_pose(settings)
    certificates = network.certificates(settings.zenoh, dt.datetime.now(dt.UTC))
    yield from certificates
    mismatched = trust.results(settings.zenoh, state=state_to_read(settings.state.path))
    yield from mismatched
    zenoh_config, found = network.zenoh_configuration(settings.zenoh)
    yield from (result for result in found if result.sentence not in {known.sentence for known in certificates})
    gateway_runs = device.held(spi_device)
    if zenoh_config is not None:
        yield from access.passes(zenoh_config, settings.zenoh.config)
        if all(each.name != "revoked" for each in mismatched):
            yield from holders.shut_out_at_the_robot(zenoh_config, settings)
        endpoints = listen_endpoints(zenoh_config)
        ports = network.ports(endpoints, gateway_runs=gateway_runs)
        yield from ports
        to_be_had = [each for each, port in zip(endpoints, ports, strict=False) if port.verdict is not Verdict.FAILURE]
        if not mismatched:  # else Zenoh's sentence about it leads nowhere
            yield from network.opens(settings.zenoh, to_be_had)
        yield from network.routers(zenoh_config)
    yield from power.results(settings.power, gateway_runs=gateway_runs)
    if settings.telemetry.metrics:
        yield network.metrics_port(settings.telemetry.metrics, gateway_runs=gateway_runs)


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"
