"""`check --zenoh-config`: whether this laptop reaches the robot, step by step, and what it may do there."""

import datetime as dt
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from gateway import certs
from gateway.errors import ConfigError, ZenohError
from gateway.onboard.check.installation import python
from gateway.onboard.check.table import CheckedRobot, Result, Verdict, results
from gateway.own_command import this_command
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Finding, Stage
from gateway.people.client.requests import Identity
from gateway.people.commands import why
from gateway.zenoh_config import client_config, connect_endpoints
from schemas.telemetry import RevocationsReport


def checks(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> Iterator[Result]:
    """Yield the result of each step to the gateway. If one endpoint reaches it, faults of the others are warnings."""
    yield from results(CheckedRobot(), python)
    try:
        config = client_config(connect, zenoh_config)
    except ConfigError as error:
        for fault in str(error).splitlines():
            yield Result("configuration", Verdict.FAILURE, fault, "fix it there, and check again")
        return
    endpoints, identity = connect_endpoints(config), Identity.of(config)
    where = str(zenoh_config) if zenoh_config is not None else "none, so without certificates"
    yield Result("configuration", Verdict.OK, f"{where}; dials {', '.join(endpoints) or 'nobody'}")
    yield from map(_result, diagnosis.own_certificates(identity, dt.datetime.now(dt.UTC)))
    if (soon := diagnosis.own_expiry(config)) is not None:
        fix = f"{certs.renewal('NAME')}, then bring its files here"
        yield Result(Stage.CERTIFICATE, Verdict.WARNING, soon, fix)
    try:
        client = Client(
            connect, zenoh_config=zenoh_config, source="hexapod-gateway check", timeout_s=timeout_s, explain=False
        )
    except ZenohError:
        yield from _way(endpoints, identity, opened=False)
        return
    with client:
        yield from _way(endpoints, identity, opened=True)
        state, allowed = why.allowed(client, identity)
    for finding in allowed:
        observer = finding.fix and finding.stage is Stage.ROLE and len(allowed) > 1
        yield _result(finding, Verdict.WARNING if observer else Verdict.FAILURE)
    if state is not None:
        yield from shut_out(state.revocations, identity)


def _way(endpoints: list[str], identity: Identity, *, opened: bool) -> Iterator[Result]:
    for endpoint, findings in diagnosis.diagnose_all(endpoints, identity).items():
        for finding in findings:
            if opened and finding.stage is Stage.GATEWAY:
                continue  # a tcp/ port without TLS is no fault: the session is open
            said = f"{endpoint}: {finding.sentence}" if len(endpoints) > 1 else finding.sentence
            yield _result(Finding(finding.stage, said, finding.fix), Verdict.WARNING if opened else Verdict.FAILURE)


def _result(finding: Finding, worst: Verdict = Verdict.FAILURE) -> Result:
    return Result(finding.stage, worst if finding.fix else Verdict.OK, finding.sentence, finding.fix)


def shut_out(there: RevocationsReport | None, identity: Identity) -> Iterator[Result]:
    """Yield which revocation list the robot has in force, with a warning if this laptop's folder has a newer one."""
    if identity.ca is None:
        return
    said, fix, folder = "the robot names no list of revoked certificates", "", identity.ca.parent
    if there is not None:
        said = f"the robot uses list {there.number} of {there.date:%Y-%m-%d}"
    with suppress(ConfigError):
        own = certs.folder.revoked(folder)
        if own is not None and own.number > (0 if there is None else there.number):
            said += f"; {folder} has list {own.number} of {own.date:%Y-%m-%d}"
            fix = f"{this_command()} certs revoke --dir {folder}"
    yield Result("revoked", Verdict.WARNING if fix else Verdict.OK, said, fix)
