"""The console on TLS, at a gateway with certificates: what its certificate lets through, and no more."""

import ssl
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from gateway import certs
from tests.support.console_process import Console, Page, SignedIn, sign_in
from tests.support.secured import Secured


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with Secured(tmp_path_factory.mktemp("secured")) as running:
        certs.folder.issue(running.folder, "web", "console", hosts=["127.0.0.1"])
        yield running


def serving(secured: Secured, state: Path, person: str) -> Console:
    """It listens on all addresses of this machine."""
    files = [f"--cert={secured.folder / 'web.pem'}", f"--key={secured.folder / 'web.key'}"]
    config = f"--zenoh-config={secured.folder / person}.json5"
    return Console(state, *files, config, address="0.0.0.0")  # noqa: S104  (with TLS)


@pytest.mark.parametrize(("person", "role"), [("anna", "operator"), ("otto", "observer")])
def test_tls(secured: Secured, tmp_path: Path, person: str, role: str) -> None:
    """The page has the rights of the console's certificate; its cookie goes over TLS only."""
    context = ssl.create_default_context(cafile=secured.folder / "web-ca.pem")
    with serving(secured, tmp_path, person) as console, httpx.Client(verify=context) as browser:
        assert console.url == f"https://127.0.0.1:{console.port}"
        link = console.new_link()
        assert link.startswith(f"{console.url}/?token=")
        entered = browser.get(link)
        cookie = entered.headers["set-cookie"]
        session = SignedIn(cookie.partition(";")[0], entered.headers["location"].partition("#")[2])
        assert cookie.startswith(f"__Host-hexapod-console-{console.port}=")
        assert {"Secure", "HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
        answer = browser.get(f"{console.url}/session", headers=session.headers)
        assert answer.json().keys() == {"nonce", "proof"}
        assert "connect-src 'self';" in answer.headers["content-security-policy"]
        rebound = browser.get(f"{console.url}/session", headers={"Host": f"localhost:{console.port}"})
        assert rebound.status_code == 403, "the certificate names the hosts"
        with Page(console.url, session, verify=context) as page:
            hello = page.hello
            assert (hello["role"], hello["person"], hello["source"]) == (role, person, f"{person} (page 1)")
            page.state()
            if role == "operator":
                assert page.stop_all()["stop_frames"] == 6
                page.send(type="lease", id=1, do="acquire")
                got = page.wait("lease")
                assert (got["mine"], got["holder"], got["verified"]) == (True, person, True)


def begun_after(time: datetime, state: dict[str, Any]) -> bool:
    return datetime.fromisoformat(state["time"]) - timedelta(seconds=state["uptime_s"]) > time


def test_sessions_of_a_console_end_when_its_certificate_is_revoked(tmp_path: Path) -> None:
    with Secured(tmp_path) as running:
        certs.folder.issue(running.folder, "web", "console", hosts=["127.0.0.1"])
        certs.folder.issue(running.folder, "bert", "operator")
        context = ssl.create_default_context(cafile=running.folder / "web-ca.pem")
        with serving(running, tmp_path, "anna") as console, httpx.Client(verify=context) as browser:
            session = sign_in(console.new_link(), context)
            changed = datetime.min.replace(tzinfo=UTC)
            for name in ("operator-40", "anna"):
                with Page(console.url, session, verify=context) as page:
                    # Each list starts the gateway anew, and a console that is not back yet does not learn of the next.
                    page.state(partial(begun_after, changed))
                    assert browser.get(f"{console.url}/session", headers=session.headers).status_code == 200
                    changed = datetime.now(UTC)
                    with running.client("bert") as bert:
                        assert bert.revocation(certs.folder.revoke(running.folder, name).pem.decode()).accepted
                    if name == "anna":
                        console.child.wait_for_output("(operator-00) is revoked: all its sessions end", 20)
                        with pytest.raises(ConnectionClosed):
                            page.wait("nothing", timeout_s=20)
            assert browser.get(f"{console.url}/session", headers=session.headers).status_code == 403
