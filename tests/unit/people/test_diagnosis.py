"""Why no connection comes about, as far as it takes no network: clocks, and what an endpoint may be."""

import datetime as dt
import time

import pytest

from gateway.people.client.diagnosis import Identity, Step, look, validity

BEGIN = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
END = dt.datetime(2028, 1, 1, tzinfo=dt.UTC)
SECOND = dt.timedelta(seconds=1)


@pytest.mark.parametrize(
    ("now", "said", "fix"),
    [
        (BEGIN, "anna.pem is good until 2028-01-01", ""),
        (END - SECOND, "anna.pem is good until 2028-01-01", ""),
        (END, "anna.pem expired on 2028-01-01", "certs renew"),
        (BEGIN - SECOND, "anna.pem is good from 2026-01-01 only, and this machine's clock says 2025-12-31", "set the"),
        (
            dt.datetime(1970, 1, 1, tzinfo=dt.UTC),
            "this machine's clock says 1970-01-01, which is before",
            "set the clock",
        ),
    ],
)
def test_a_certificate_and_a_clock(now: dt.datetime, said: str, fix: str) -> None:
    finding = validity("anna.pem", BEGIN, END, now)
    assert finding.step is Step.CERTIFICATE
    assert finding.sentence.startswith(said)
    assert fix in finding.fix
    assert bool(finding.fix) is bool(fix)


@pytest.mark.parametrize("endpoint", ["tls/[2001:db8::7]:7447", "quic/robot:7447", "robot:7447", "tls/robot"])
def test_what_is_not_dialled_is_reported_at_once(endpoint: str) -> None:
    (finding,) = look(endpoint, Identity(), time.monotonic() + 1)
    assert finding.step is Step.ENDPOINT
    assert finding.fix
