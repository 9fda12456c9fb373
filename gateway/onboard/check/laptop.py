"""`check --zenoh-config`: whether this laptop reaches the robot, step by step, and what it may do there."""

import datetime as dt
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from gateway.certs import expiry
from gateway.errors import ConfigError, ZenohError
from gateway.onboard.check import holders, machine
from gateway.onboard.check.result import Result, Verdict, failure, ok, warning
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Finding, Stage
from gateway.people.client.requests import Identity
from gateway.people.tools import why
from gateway.zenoh_config import client_config, connect_endpoints
from schemas.telemetry import CertificateReport

_SOURCE: Final = "hexapod-gateway check"


def checks(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> Iterator[Result]:
    """All steps from the file to the gateway. One host that leads there is enough; the others are warnings then."""
    yield machine.python()
    try:
        config = client_config(connect, zenoh_config)
    except ConfigError as error:
        for fault in str(error).splitlines():
            yield failure("configuration", fault, "fix it there, and check again")
        return
    endpoints = connect_endpoints(config)
    where = str(zenoh_config) if zenoh_config is not None else "none, so without certificates"
    yield ok("configuration", f"{where}; dials {', '.join(endpoints) or 'nobody'}")
    yield machine.clock()
    identity = Identity.of(config)
    for finding in diagnosis.own_certificates(identity, dt.datetime.now(dt.UTC)):
        yield _result(finding)
    if (soon := diagnosis.own_expiry(config)) is not None:
        yield warning(Stage.CERTIFICATE, soon, "hexapod-gateway certs renew, where ca.key is, and copy it here")
    try:
        client = Client(connect, zenoh_config=zenoh_config, source=_SOURCE, timeout_s=timeout_s, explain=False)
    except ZenohError:
        yield from _way(endpoints, identity, opened=False)
        return
    with client:
        yield from _way(endpoints, identity, opened=True)
        state, allowed = why.allowed(client, identity)
    for finding in allowed:
        observer = finding.fix and finding.stage is Stage.ROLE and len(allowed) > 1
        yield _result(finding, Verdict.WARNING if observer else Verdict.FAILURE)
    if state is not None and state.certificate is not None:
        yield from _robots_certificate(state.certificate, state.time)
    if state is not None:
        yield from holders.shut_out_from_the_laptop(state.revocations, identity)


def _robots_certificate(certificate: CertificateReport, now: dt.datetime) -> Iterator[Result]:
    soon = expiry.soon(certificate.file, certificate.expires, now)
    if soon is not None:
        fix = "hexapod-gateway certs renew gateway, where ca.key is, copy it to the robot, and restart the service"
        yield warning(Stage.CERTIFICATE, f"the robot's {soon}", fix)


def _way(endpoints: list[str], identity: Identity, *, opened: bool) -> Iterator[Result]:
    for endpoint, findings in diagnosis.look_at_all(endpoints, identity).items():
        for finding in findings:
            if opened and finding.stage is Stage.GATEWAY:
                continue  # that no gateway speaks TLS on a tcp/ port is no fault: the session is open
            said = f"{endpoint}: {finding.sentence}" if len(endpoints) > 1 else finding.sentence
            worst = Verdict.WARNING if opened else Verdict.FAILURE
            yield _result(Finding(finding.stage, said, finding.fix), worst)


def _result(finding: Finding, worst: Verdict = Verdict.FAILURE) -> Result:
    return Result(finding.stage, worst if finding.fix else Verdict.OK, finding.sentence, finding.fix)
