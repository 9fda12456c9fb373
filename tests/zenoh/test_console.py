"""The console between real pages and a real gateway: what is shown, what is sent, who drives, and who is let in."""

import re
import ssl
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Final

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from gateway import certs
from gateway.people.walking.gaits import GAITS
from schemas.robot import LEGS
from tests.support.console_process import NOBODY, Console, Page, SignedIn, sign_in
from tests.support.fixtures import console_fixture, gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway, Secured, free_port

LEG_3 = "hexapod/leg/3/cmd"
START = {"servos": [{"op": "start", "angle_deg": angle} for angle in (90, 45, 120)]}
SET = {"servos": [{"op": "set", "angle_deg": angle} for angle in (91, 46, 121)]}
STOP = {"servos": [{"op": "stop"}] * 3}
TTL_MS: Final = 3000

gateway = gateway_fixture(patient(5000, lease={"ttl_ms": TTL_MS}))
console = console_fixture()
session = session_fixture()


@pytest.fixture
def page(console: Console, session: SignedIn) -> Iterator[Page]:
    with console.page(session) as opened:
        opened.state(lambda state: state["lease"]["holder"] is None)
        state = opened.state(lambda state: state["mode"] in ("idle", "estopped"))
        if state["mode"] == "estopped":
            assert opened.reset(state["estop"])["ack"]["accepted"]
        yield opened


@pytest.fixture
def other(console: Console, session: SignedIn) -> Iterator[Page]:
    with console.page(session) as opened:
        yield opened


# ---- driving and stopping


def test_a_page_sees_and_drives(page: Page) -> None:
    assert (page.hello["role"], page.hello["version"]) == ("operator", page.state()["version"])
    assert len(page.hello["geometry"]["servos"]) == 18
    assert page.hello["gaits"] == list(GAITS)
    assert page.ask(LEG_3, START)["ack"] == {"accepted": True}
    leg = page.state(lambda state: state["mode"] == "active")["legs"][2]
    assert leg["source"] == page.hello["source"]

    def is_there(state: dict[str, Any]) -> bool:
        page.put(LEG_3, SET)  # again with each state, as one may be late on its way
        return [servo["angle_deg"] for servo in state["legs"][2]["servos"]] == [91, 46, 121]

    page.state(is_there)
    assert page.ask(LEG_3, STOP)["ack"]["accepted"]
    page.state(lambda state: state["mode"] == "idle")


def test_stop_all_and_reset(page: Page, other: Page) -> None:
    assert page.ask(LEG_3, START)["ack"]["accepted"]
    stopped = page.stop_all()
    assert stopped["stop_frames"] == len(LEGS)
    assert stopped["latency_us"] > 0
    other.wait("state", lambda message: message["state"]["estop"] == stopped["estop"])
    assert other.state()["mode"] == "estopped"
    assert other.wait("event", lambda message: message["event"]["kind"] == "estop_engaged")
    again = other.stop_all()
    assert again["estop"] == stopped["estop"] + 1
    ack = page.reset(stopped["estop"])["ack"]
    assert (ack["accepted"], ack["reason"]) == (False, "estopped"), "not the one that the other page asked for"
    assert page.reset(again["estop"])["ack"]["accepted"]


def test_who_takes_a_leg_from_a_page_is_named(page: Page, other: Page) -> None:
    began = datetime.now(UTC)
    assert page.ask(LEG_3, START)["ack"]["accepted"]
    assert other.ask(LEG_3, SET)["ack"]["accepted"]
    taken = page.event("source_changed", since=began)
    first, second = page.hello["source"], other.hello["source"]
    assert first != second
    assert (taken["source"], taken["detail"]) == (second, f"leg 3 is commanded by {second}, and was by {first}")
    assert other.ask(LEG_3, STOP)["ack"]["accepted"]
    page.state(lambda state: state["mode"] == "idle")


# ---- who drives: the lease is one WebSocket's, lives by that page's own requests, and ends with it


def test_the_token_stays_in_the_server(page: Page, other: Page) -> None:
    """No message to any page has it: 32 hex digits in a row that are not the Zenoh id of a session."""
    began = datetime.now(UTC)
    assert page.lease("acquire")["mine"]
    acquired = other.event("lease_acquired", since=began)
    assert page.ask(LEG_3, START)["ack"]["accepted"]
    assert page.ask(LEG_3, STOP)["ack"]["accepted"]
    assert page.lease("renew")["mine"]
    assert not page.lease("release")["mine"]
    other.state()
    heard = page.heard + other.heard
    assert any('"mine":true' in text for text in heard)
    ids = set(re.findall('"source_id":"([0-9a-f]+)"', " ".join(heard)))  # Zenoh writes no leading zeros
    assert acquired["source_id"] in ids
    assert set(re.findall("[0-9a-f]{32}", " ".join(heard))) <= ids


def test_a_page_whose_lease_has_ended_resets_where_nobody_drives_and_starts_nothing(page: Page, other: Page) -> None:
    assert page.lease("acquire")["mine"]
    assert other.lease("take")["mine"]
    assert page.lease("renew")["mine"] is False
    estop = page.stop_all()["estop"]
    assert page.reset(estop)["ack"]["reason"] == "not_holder"
    assert other.lease("release")["accepted"]
    assert page.reset(estop)["ack"] == {"accepted": True}
    assert page.ask(LEG_3, START)["ack"]["reason"] == "not_holder", "it has not asked for the lease anew"


def test_only_the_page_itself_renews_it(page: Page, other: Page) -> None:
    """A page that is frozen has an open socket, and loses the lease all the same."""
    began = datetime.now(UTC)
    assert page.lease("acquire")["mine"]
    for _ in range(3):
        other.state()
        assert page.lease("renew")["mine"]
    other.event("lease_expired", since=began)
    for _ in range(10):  # a second later it is over by the console's own clock, too
        other.state()
    lost = page.lease("renew")
    assert (lost["mine"], lost["accepted"]) == (False, False)
    assert (lost["end"], lost["silent_s"] * 1000 > TTL_MS) == ("page_silent", True)


# ---- who gets in


def test_nobody_without_the_cookie(console: Console) -> None:
    for path in ("/", "/session", "/main.js", "/ws", "/nothing"):
        assert console.get(path).status_code == 403
    assert "console --link" in console.get("/").text
    with pytest.raises(InvalidStatus, match="403"):
        Page(console.url, NOBODY)


# ---- bad pages


@pytest.mark.parametrize("send", [lambda page: page.send(type="alive", now_ms=1), lambda page: page.socket.ping()])
def test_a_flood_ends_it_and_delays_nobody(
    console: Console, session: SignedIn, page: Page, send: Callable[[Page], object]
) -> None:
    def run_wild(flood: Page) -> None:
        for _ in range(10_000):
            send(flood)
        flood.wait("never")

    with console.page(session) as wild, pytest.raises(ConnectionClosed):
        run_wild(wild)
    assert page.stop_all()["stop_frames"] == len(LEGS)


# ---- its own beginning and end


def test_the_console_waits_for_a_gateway(tmp_path: Path) -> None:
    """Also a stop that was asked for before there was one; and it says when the gateway has gone."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with Console(tmp_path, "--connect", endpoint) as console, console.page(console.sign_in()) as page:
        gone = page.wait("link", lambda message: message["status"] == "gone" and "nothing listens" in message["detail"])
        assert endpoint.removeprefix("tcp/") in gone["detail"]
        page.send(type="stop_all", id=7)
        assert not page.wait("stop")["answered"]
        with Gateway(tmp_path, {"zenoh": {"listen": [endpoint]}}) as gateway:
            assert page.wait("stop", lambda message: message["answered"])["id"] == 7
            page.wait("link", lambda message: message["status"] == "connected")
            gateway.child.kill()
            page.wait("link", lambda message: message["status"] == "gone")


def test_the_consoles_end_gives_back_a_lease_that_is_granted_meanwhile(gateway: Gateway, tmp_path: Path) -> None:
    with Console(tmp_path, "--connect", gateway.endpoint) as own, own.page(own.sign_in()) as page:
        page.state()
        page.send(type="lease", id=1, do="acquire")
        own.child.terminate()
        own.child.wait()
    with gateway.client() as client:
        assert client.state().lease.holder is None


# ---- on TLS, at a gateway with certificates


@pytest.fixture(scope="module")
def secured(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Secured]:
    with Secured(tmp_path_factory.mktemp("secured")) as running:
        certs.folder.issue(running.folder, "web", "console", hosts=["127.0.0.1"])
        yield running


def serving(secured: Secured, state: Path, person: str) -> Console:
    """Yield a console that listens on all addresses of this machine."""
    files = [f"--cert={secured.folder / 'web.pem'}", f"--key={secured.folder / 'web.key'}"]
    config = f"--zenoh-config={secured.folder / person}.json5"
    return Console(state, *files, config, address="0.0.0.0")  # noqa: S104  (with TLS)


@pytest.mark.parametrize(("person", "role"), [("anna", "operator"), ("otto", "observer")])
def test_the_console_reaches_a_gateway_with_certificates(
    secured: Secured, tmp_path: Path, person: str, role: str
) -> None:
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
                got = page.lease("acquire")
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
