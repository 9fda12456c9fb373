"""How a page and its console show each other that they know the session's key, which neither sends."""

import json
import re
from hashlib import sha256
from pathlib import Path

import pytest
from aiohttp import web
from multidict import CIMultiDict

from gateway.people.console.server.auth import MAX_NONCES, NONCE_S, Auth, SignedIn, proof
from gateway.people.console.server.sessions import Sessions, SignIn
from gateway.people.console.server.site import site

URL = "http://127.0.0.1:8080"


class Visitor:
    """A browser's requests at the door of a console, in virtual time."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr("gateway.people.console.server.auth.time.monotonic", lambda: self.now_s)
        self._sessions = Sessions(folder, 8080)
        self._sessions.begin(URL, "operator")
        self._site = site("127.0.0.1:8080", None, None)
        self._auth = Auth(self._site, self._sessions, "operator")

    def sign_in(self) -> SignIn:
        found = self._sessions.exchange(self._sessions.new_link().partition("=")[2])
        assert found is not None
        return found

    def follow_link(self, card: str) -> str:
        """Where a browser goes that opens a link to this card."""
        link = self._sessions.new_link().removeprefix(URL)
        answer = self._auth.answer("GET", f"{link}&card={card}", CIMultiDict({"Host": "127.0.0.1:8080"}))
        assert isinstance(answer, web.Response)
        return answer.headers["Location"]

    def get(self, path: str, session: SignIn, **headers: str) -> web.Response | SignedIn:
        cookie = f"{self._site.cookie}={session.cookie}"
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        return self._auth.answer("GET", path, CIMultiDict({"Host": "127.0.0.1:8080", "Cookie": cookie, **names}))

    def nonce(self, session: SignIn, mine: str = "mine") -> tuple[str, str]:
        """The console's, and its proof."""
        answer = self.get(f"/session?nonce={mine}", session)
        assert isinstance(answer, web.Response)
        assert answer.text is not None
        found = json.loads(answer.text)
        assert session.key not in answer.text
        return found["nonce"], found["proof"]

    def comes_in(self, session: SignIn, offered: str) -> bool:
        subprotocols = {"Sec_WebSocket_Protocol": f"hexapod-console, {offered}"}
        return isinstance(self.get("/ws", session, Origin=URL, **subprotocols), SignedIn)


@pytest.fixture
def visitor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Visitor:
    return Visitor(tmp_path, monkeypatch)


def hashed(key: str) -> str:
    return sha256(key.encode()).hexdigest()


@pytest.mark.parametrize(
    ("card", "behind"),
    [("cal", "?cal"), ("", ""), ("x%0d%0aSet-Cookie:%20a", ""), ("%C3%A4", ""), ("/evil.example", "")],
)
def test_a_link_leads_to_a_card_and_nowhere_else(visitor: Visitor, card: str, behind: str) -> None:
    assert re.fullmatch(rf"/enter.html{re.escape(behind)}#[\w-]+", visitor.follow_link(card))


def test_each_shows_the_other_that_it_knows_the_key(visitor: Visitor) -> None:
    session = visitor.sign_in()
    nonce, shown = visitor.nonce(session)
    assert shown == proof(hashed(session.key), f"console mine {nonce}")
    offered = f"proof.{nonce}.{proof(hashed(session.key), f'page {nonce}')}"
    assert visitor.comes_in(session, offered)
    assert not visitor.comes_in(session, offered), "a nonce serves once"


def test_what_is_no_proof_lets_nobody_in(visitor: Visitor) -> None:
    session, other = visitor.sign_in(), visitor.sign_in()
    made = proof(hashed(session.key), "page ")
    for offered in ("", "proof.", "proof..", f"proof..{made}", f"key.{session.key}", f"proof.\u00e4.{made}"):
        assert not visitor.comes_in(session, offered)
    for key, text in (
        (other.key, "page {}"),
        (session.key, "console mine {}"),
        (session.cookie, "page {}"),
        ("", "page {}"),
    ):
        nonce, _ = visitor.nonce(session)
        assert not visitor.comes_in(session, f"proof.{nonce}.{proof(hashed(key), text.format(nonce))}")
    nonce, shown = visitor.nonce(session, "page")
    assert not visitor.comes_in(session, f"proof.{nonce}.{shown}"), "the console's own proof is none of the page's"


def test_a_nonce_serves_for_a_short_time_and_few_are_kept(visitor: Visitor) -> None:
    session = visitor.sign_in()

    def offer() -> str:
        nonce, _ = visitor.nonce(session)
        return f"proof.{nonce}.{proof(hashed(session.key), f'page {nonce}')}"

    late, early = offer(), offer()
    visitor.now_s += NONCE_S - 0.1
    assert visitor.comes_in(session, early)
    visitor.now_s += 0.1
    assert not visitor.comes_in(session, late)
    pushed_out = offer()
    for _ in range(MAX_NONCES):
        kept = offer()
    assert visitor.comes_in(session, kept)
    assert not visitor.comes_in(session, pushed_out)
