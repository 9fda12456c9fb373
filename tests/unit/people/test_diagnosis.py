"""Why no connection comes about, as far as it takes no network: clocks, and what an endpoint may be."""

import datetime as dt
import socket
import ssl
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from gateway import certs
from gateway.certs import authority
from gateway.people.client.diagnosis import Stage, diagnose, validity
from gateway.people.client.lease_requests import Identity
from gateway.people.commands import why
from gateway.zenoh.config import client_config, connect_endpoints

BEGIN = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)
END = dt.datetime(2028, 1, 1, tzinfo=dt.UTC)
SECOND = dt.timedelta(seconds=1)
DAY = dt.timedelta(days=1)


@pytest.mark.parametrize(
    ("now", "said", "fix"),
    [
        (BEGIN, "anna.pem is good until 2028-01-01", ""),
        (END - SECOND, "anna.pem is good until 2028-01-01", ""),
        (END, "anna.pem expired on 2028-01-01", "certs renew"),
        (
            BEGIN - SECOND,
            "anna.pem is good from 2026-01-01 only, and this machine's clock states 2025-12-31",
            "set the",
        ),
        (
            dt.datetime(1970, 1, 1, tzinfo=dt.UTC),
            "this machine's clock states 1970-01-01, which is before",
            "set the clock",
        ),
    ],
)
def test_a_certificate_and_a_clock(now: dt.datetime, said: str, fix: str) -> None:
    finding = validity("anna.pem", BEGIN, END, now)
    assert finding.stage is Stage.CERTIFICATE
    assert finding.sentence.startswith(said)
    assert fix in finding.fix
    assert bool(finding.fix) is bool(fix)


@pytest.mark.parametrize(
    ("endpoint", "dialled"),
    [
        ("tcp/[fe80::1%wlan0]:7447", "tcp/[fe80::1]:7447#iface=wlan0"),
        ("[fe80::1%eth0.7]:7447", "tcp/[fe80::1]:7447#iface=eth0.7"),
        ("tcp/[::1]:7447", "tcp/[::1]:7447"),
    ],
)
def test_the_interface_of_a_link_local_address_is_zenohs(endpoint: str, dialled: str) -> None:
    assert connect_endpoints(client_config(endpoint)) == [dialled]


@pytest.mark.parametrize("endpoint", ["tls/[2001:db8::7]:7447", "quic/robot:7447", "robot:7447", "tls/robot"])
def test_what_is_not_dialled_is_reported_at_once(endpoint: str) -> None:
    (finding,) = diagnose(endpoint, Identity(), time.monotonic() + 1)
    assert finding.stage is Stage.ENDPOINT
    assert finding.fix


@pytest.mark.parametrize(
    ("role", "sentence", "fix"),
    [
        ("gateway", "the robot's certificate has expired", "hexapod-gateway certs renew gateway"),
        ("operator", "the robot's certificate is no robot's, such as a laptop's", "setup --certs FOLDER"),
    ],
)
def test_a_robot_with_a_wrong_certificate(role: str, sentence: str, fix: str, tmp_path: Path) -> None:
    """Expired, as after two years in a cupboard: the service would not start with it, but one that runs goes on."""
    certs.folder.init(tmp_path, ["127.0.0.1"])
    certs.folder.issue(tmp_path, "anna", "operator")
    ca = certs.folder.load_ca(tmp_path)
    now = dt.datetime.now(dt.UTC)
    wrong = authority.make_leaf(ca, "gateway", "gateway", ["127.0.0.1"], 1, now - 2 * DAY)
    wrong = wrong if role == "gateway" else authority.make_leaf(ca, "operator-07", "bob", [], 9, now)
    (tmp_path / "old.pem").write_bytes(wrong.certificate_pem())
    (tmp_path / "old.key").write_bytes(wrong.key_pem())
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "old.pem", tmp_path / "old.key")
    with socket.create_server(("127.0.0.1", 0)) as robot:

        def shake_hands() -> None:
            with suppress(OSError), robot.accept()[0] as connection:
                context.wrap_socket(connection, server_side=True)

        threading.Thread(target=shake_hands, daemon=True).start()
        identity = Identity(tmp_path / "anna.pem", tmp_path / "anna.key", tmp_path / "ca.pem")
        *_, last = diagnose(f"tls/127.0.0.1:{robot.getsockname()[1]}", identity, time.monotonic() + 10)
    assert last.sentence == sentence
    assert fix in last.fix


def test_a_certificate_that_has_run_out_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of somebody who watches: the link ends with it, and this is why."""
    certs.folder.init(tmp_path, ["127.0.0.1"])
    monkeypatch.setattr(certs.folder, "now_utc", lambda: dt.datetime.now(dt.UTC) - 2 * DAY)
    certs.folder.issue(tmp_path, "dora", "operator", days=1)
    (line,) = why.unreached(None, tmp_path / "dora.json5")
    assert "dora.pem expired on" in line
    assert "hexapod-gateway certs renew NAME --dir DIR" in line
