"""`check --zenoh-config`: whether this laptop reaches the robot, step by step, and what it may do there."""

import datetime as dt
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

from gateway import certs
from gateway.errors import ConfigError, ZenohError
from gateway.onboard.check.table import Result, Verdict
from gateway.people.client import diagnosis
from gateway.people.client.blocking import Client
from gateway.people.client.diagnosis import Finding, Stage
from gateway.people.client.requests import Identity
from gateway.people.commands import why
from gateway.zenoh_config import client_config, connect_endpoints


def checks(connect: str | None, zenoh_config: Path | None, timeout_s: float) -> Iterator[Result]:
    """Yield the result of each step to the gateway. If one endpoint reaches it, faults of the others are warnings."""
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
