"""`hexapod-gateway check`: print what is missing on this machine to run the service, and the command that fixes it.

It changes nothing: no byte reaches the robot, and a running gateway is not disturbed.
"""

import grp
import os
import pwd
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Final

from gateway.errors import ConfigError, ZenohError
from gateway.files import nesting
from gateway.host import effective
from gateway.host.directories import CONFIGURATION
from gateway.onboard import whole
from gateway.onboard.check import installation, security, table, wire
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, results
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Finding, Stage
from gateway.people.client.lease_requests import Identity
from gateway.people.commands import why
from gateway.people.terminal import clear_line, hint, show_line
from gateway.robot import settings as settings_file
from gateway.robot.settings import FramingNotSetError
from gateway.zenoh.config import client_config, connect_endpoints


def check(config: Path | None, *, as_json: bool = False) -> int:
    """Check this machine, and print each line at once. Return the exit code: 0, or 1 after a failure.

    As root, check with the rights of the service's user. Raises ConfigError if this user may not read the
    configuration, and FramingNotSetError.
    """
    service = next(((each.pw_uid, each.pw_gid) for each in pwd.getpwall() if each.pw_name == table.SERVICE), None)
    robot = CheckedRobot(unit=table.shown(table.SERVICE), service=service)
    show_line("reading the files of the installed release …")
    installed = whole.CURRENT.is_dir() or robot.unit.get("LoadState") == "loaded"
    seen = list(results(robot, *installation.AS_ROOT)) if installed else []  # root sees it all
    robot.open_files.look()
    clear_line()
    _go_on_as_the_service(robot)
    return report(run(config, robot, seen), "run the service", as_json=as_json)


_ASKS: Final = "to be asked which framing the controller needs: sudo hexapod-gateway setup"


def _go_on_as_the_service(robot: CheckedRobot) -> None:
    """If root, go on in a child process of the service's user, if that exists: root may do more than the service."""
    if os.geteuid() or robot.service is None:
        return
    for module in ("gateway.certs.folder", "serial", "spidev"):
        with suppress(ImportError):  # the service's user may not be able to read this Python's folder
            import_module(module)
    sys.stdout.flush()
    if child := os.fork():
        sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    user = pwd.getpwuid(robot.service[0])
    groups = {each.gr_gid for each in grp.getgrall() if each.gr_name in installation.GROUPS}
    try:
        os.setgroups(sorted(groups | set(os.getgrouplist(user.pw_name, user.pw_gid))))
        os.setgid(user.pw_gid)
        os.setuid(user.pw_uid)
    except PermissionError:
        hint(f"All this is checked as root, which may not become {user.pw_name}: give the container SETUID and SETGID.")


def report(found: Iterable[Result], can: str, *, as_json: bool) -> int:
    """Print each line at once, and what the machine `can` do. Return the exit code: 1 after a failure."""
    lines = list[Result]()
    for result in found:
        lines.append(result)
        if not as_json:
            table.show(*result)
    count = Counter(each.verdict for each in lines)
    passed = not count[Verdict.FAILURE]
    counts = ", ".join(f"{count[each]} {each}{'s' * (count[each] != 1)}" for each in (Verdict.FAILURE, Verdict.WARNING))
    end = f"{'can' if passed else 'cannot'} {can}: {counts}"
    checks = {"checks": [each._asdict() for each in lines]} if as_json else None
    return table.conclude(f"This machine {end}.", well=passed, as_json=checks)


def run(config: Path | None, robot: CheckedRobot, seen: Sequence[Result]) -> Iterator[Result]:
    """Yield all results in order, those of the settings only if the settings can be read. `seen`: results known before.

    While the service runs and `config` is None, check its device with the settings in use. Raises FramingNotSetError.
    """
    path, faults, unset = config or CONFIGURATION, list[str](), False
    used = effective.running() if config is None else None
    in_unit = used is not None and "HEXAPOD_SPI__FRAMING" in robot.unit.get("Environment", "").upper()
    try:
        robot.settings = settings_file.load(config, simulated=in_unit)
    except ConfigError as error:
        faults, unset = str(error).splitlines(), isinstance(error, FramingNotSetError)
        if unset and used is None:  # else it runs, and would not start again
            asks = f"\n{_ASKS}" if robot.unit.get("LoadState") == "loaded" else ""
            raise FramingNotSetError(f"{error}{asks}") from None
        if security.DENIED in faults[0] and os.geteuid() not in (0, robot.service and robot.service[0]):
            unread = f"{path} is not for you to read, as it may name keys: sudo hexapod-gateway check"
            raise ConfigError(unread) from None
    yield from seen
    for fault in faults:
        later = "fix it there, and check again: device, ports and certificates are checked after that"
        fix = table.LET_READ if security.DENIED in fault else _ASKS if unset and "spi.framing: " in fault else later
        if nesting.NO_TEXT in fault:
            fix = f"put a copy of it there, or begin anew: sudo mv {path} {path}.bad; sudo hexapod-gateway setup"
        yield Result("configuration", Verdict.FAILURE, fault, fix)
    if not faults:
        where = str(path) if path.exists() else f"the defaults, since there is no {path}"
        yield Result("configuration", Verdict.OK, where)
        if used is not None:
            uart = replace(robot.settings.controller, uart=used.controller.uart)
            robot.settings = replace(robot.settings, wire=used.wire, spi=used.spi, controller=uart)
            fix = "state in the file what the controller needs; take the variable out (systemctl cat hexapod-gateway)"
            yield from (Result("in use", Verdict.WARNING, each, fix) for each in effective.differences(used, path))
        yield from results(robot, installation.state_disk, *wire.PROBES, *security.PROBES, wire.power)
    yield from results(robot, installation.unit, installation.restarts, installation.machine)


# ---- from a laptop


def laptop(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> Iterator[Result]:
    """Yield whether this laptop reaches the gateway, step by step, and what it may do there.

    If one endpoint reaches it, faults of the others are warnings.
    """
    try:
        config = client_config(connect, zenoh_config)
    except ConfigError as error:
        for fault in str(error).splitlines():
            yield Result("configuration", Verdict.FAILURE, fault, "fix it there, and check again")
        return
    endpoints, identity = connect_endpoints(config), Identity.of(config)
    where = str(zenoh_config) if zenoh_config is not None else "none, so without certificates"
    yield Result("configuration", Verdict.OK, f"{where}; dials {', '.join(endpoints) or 'nobody'}")
    yield from map(_result, diagnosis.own_certificates(identity))
    source = "hexapod-gateway check"
    with ExitStack() as stack:
        client = None
        with suppress(ZenohError):
            made = Client(connect, zenoh_config=zenoh_config, source=source, timeout_s=timeout_s, explain=False)
            client = stack.enter_context(made)
        for endpoint, findings in diagnosis.diagnose_all(endpoints, identity).items():
            at = f"{endpoint}: " if len(endpoints) > 1 else ""
            for finding in findings:
                if client is None or finding.stage is not Stage.GATEWAY:  # tcp/ without TLS is no fault if it opens
                    yield _result(finding, Verdict.FAILURE if client is None else Verdict.WARNING, at)
        allowed = [] if client is None else why.allowed(client, identity)
    for finding in allowed:
        observer = finding.fix and finding.stage is Stage.ROLE and len(allowed) > 1
        yield _result(finding, Verdict.WARNING if observer else Verdict.FAILURE)


def _result(finding: Finding, worst: Verdict = Verdict.FAILURE, at: str = "") -> Result:
    return Result(finding.stage, worst if finding.fix else Verdict.OK, f"{at}{finding.sentence}", finding.fix)
