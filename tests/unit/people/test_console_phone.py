"""Which certificate `console --phone` uses, and how little its page without TLS answers."""

import ssl
from collections.abc import Sequence
from pathlib import Path

import pytest
from aiohttp import web
from multidict import CIMultiDict
from yarl import URL

from gateway import certs
from gateway.people.commands.options import Reach
from gateway.people.console.phone import explain, prepared
from gateway.people.console.server.site import Options, site

LISTEN = "192.0.2.7:8443"


def prepare(folder: Path, listen: str = LISTEN) -> Options:
    return prepared(Options(Reach(), listen, phone=True), folder)


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))


def test_a_certificate_for_the_address_is_made_once_and_its_key_stays_private(tmp_path: Path) -> None:
    first = prepare(tmp_path)
    assert first.cert is not None
    made = first.cert.read_bytes()
    assert first.cert.stat().st_mode & 0o777 == 0o600
    assert site(LISTEN, first.cert, first.key).url == "https://192.0.2.7:8443"
    ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(first.cert, first.key)
    assert prepare(tmp_path) == first
    assert first.cert.read_bytes() == made, "a phone that has accepted it is not asked again"
    assert prepare(tmp_path, "192.0.2.8:8443").cert == first.cert
    assert first.cert.read_bytes() != made, "at another address"


@pytest.mark.parametrize(("hosts", "uses"), [(["192.0.2.7", "robot.local"], True), (["robot.local"], False)])
def test_the_fleets_certificate_is_used_where_it_fits(tmp_path: Path, hosts: Sequence[str], uses: bool) -> None:
    fleet = tmp_path / "hexapod-certs"
    certs.folder.init(fleet, ["robot.local"])
    certs.folder.issue(fleet, "web", "console", hosts=hosts)
    found = prepare(tmp_path)
    assert (found.cert == fleet / "web.pem", found.key == fleet / "web.key") == (uses, uses)


@pytest.mark.parametrize(("target", "status"), [("/", 200), ("/tap.js", 200), ("/../phone.pem", 404), ("/ws", 404)])
async def test_the_page_without_tls_answers_with_its_own_files_only(target: str, status: int) -> None:
    answer = await explain(URL(target), CIMultiDict({"Host": "192.0.2.7:8080"}))
    assert isinstance(answer, web.Response)
    assert answer.status == status
    assert answer.keep_alive is False
    assert "default-src 'none'" in answer.headers["content-security-policy"]
