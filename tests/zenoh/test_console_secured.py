"""The console on TLS, at a gateway with certificates: what its certificate lets through, and no more."""

import ssl
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from gateway import certs
from gateway.people.console.register import Register
from tests.support.child import Child
from tests.support.console_process import LINK, Page, SignedIn
from tests.support.gateway_process import COMMAND, free_port
from tests.support.secured import Secured


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with Secured(tmp_path_factory.mktemp("secured")) as running:
        certs.folder.console(running.folder, "web", ["127.0.0.1"])
        yield running


def console(secured: Secured, state: Path, person: str, port: int) -> Child:
    """It listens on all addresses of this machine."""
    files = [f"--cert={secured.folder / 'web.pem'}", f"--key={secured.folder / 'web.key'}"]
    config = f"--zenoh-config={secured.folder / person}.json5"
    command = [*COMMAND, "console", "--listen", f"0.0.0.0:{port}", *files, config]
    return Child(command, {"STATE_DIRECTORY": str(state), "PATH": "/usr/bin:/bin"})


@pytest.mark.parametrize(("person", "role"), [("anna", "operator"), ("otto", "observer")])
def test_tls(secured: Secured, tmp_path: Path, person: str, role: str) -> None:
    """The page has the rights of the console's certificate; its cookie goes over TLS only."""
    child = console(secured, tmp_path, person, port := free_port())
    try:
        assert child.wait_for_output(LINK).removeprefix(LINK).strip() == f"https://127.0.0.1:{port}"
        link = Register(tmp_path, port).new_link()
        assert link.startswith(f"https://127.0.0.1:{port}/?token=")
        context = ssl.create_default_context(cafile=secured.folder / "web-ca.pem")
        with httpx.Client(verify=context) as browser:
            entered = browser.get(link)
            cookie = entered.headers["set-cookie"]
            session = SignedIn(cookie.partition(";")[0], entered.headers["location"].partition("#")[2])
            assert cookie.startswith(f"__Host-hexapod-console-{port}=")
            assert {"Secure", "HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
            answer = browser.get(f"https://127.0.0.1:{port}/session", headers=session.headers)
            assert answer.json() == {"role": role, "person": person}
            assert f"connect-src 'self' wss://127.0.0.1:{port};" in answer.headers["content-security-policy"]
            rebound = browser.get(f"https://127.0.0.1:{port}/session", headers={"Host": f"localhost:{port}"})
            assert rebound.status_code == 403, "the certificate names the hosts"
        url = f"https://127.0.0.1:{port}"
        with Page(url, session, verify=context) as page:
            hello = page.hello
            assert (hello["role"], hello["person"], hello["source"]) == (role, person, f"{person} (page 1)")
            page.state()
            if role == "operator":
                assert page.stop_all()["stop_frames"] == 6
                page.send(type="lease", id=1, do="acquire")
                got = page.wait("lease")
                assert (got["mine"], got["holder"], got["verified"]) == (True, person, True)
    finally:
        child.close()


def test_sessions_of_a_console_end_when_its_certificate_is_revoked(tmp_path: Path) -> None:
    with Secured(tmp_path) as running:
        certs.folder.console(running.folder, "web", ["127.0.0.1"])
        certs.folder.issue(running.folder, "bert", "operator")
        child = console(running, tmp_path, "anna", port := free_port())
        try:
            child.wait_for_output(LINK)
            context = ssl.create_default_context(cafile=running.folder / "web-ca.pem")
            with httpx.Client(verify=context) as browser:
                entered = browser.get(Register(tmp_path, port).new_link())
                cookie = entered.headers["set-cookie"].partition(";")[0]
                session = SignedIn(cookie, entered.headers["location"].partition("#")[2])
                url = f"https://127.0.0.1:{port}"
                for name in ("operator-40", "anna"):
                    with Page(url, session, verify=context) as page, running.client("bert") as bert:
                        page.state()
                        assert browser.get(f"{url}/session", headers=session.headers).status_code == 200
                        bert.wait_ready()
                        assert bert.revocation(certs.moving.revoke(running.folder, name).pem.decode()).accepted
                        if name == "anna":
                            child.wait_for_output("(operator-00) is revoked: all its sessions end", 20)
                            with pytest.raises(ConnectionClosed):
                                page.wait("nothing", timeout_s=20)
                assert browser.get(f"{url}/session", headers=session.headers).status_code == 403
        finally:
            child.close()
