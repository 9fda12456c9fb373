"""How a page and its console show each other that they know the session's key, which neither sends."""

import json
import re
from hashlib import sha256
from pathlib import Path

import pytest
from aiohttp import web
from multidict import CIMultiDict
from yarl import URL

from gateway.people.console.server.auth import NONCE_NS, Auth, SignedIn, proof
from gateway.people.console.server.sessions import Sessions, SignIn
from gateway.people.console.server.site import site

HERE = "http://127.0.0.1:8080"


class Visitor:
    """A browser's requests at the door of a console, in virtual time."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns = 100_000_000_000
        monkeypatch.setattr("gateway.people.console.server.auth.time.monotonic_ns", lambda: self.now_ns)
        self._sessions = Sessions(folder, 8080)
        self._sessions.begin(HERE, "operator")
        self._site = site("127.0.0.1:8080", None, None)
        self._auth = Auth(self._site, self._sessions, "operator")

    def sign_in(self) -> SignIn:
        found = self._sessions.exchange(self._sessions.new_link().partition("=")[2])
        assert found is not None
        return found

    def follow_link(self, card: str) -> str:
        """Where a browser goes that opens a link to this card."""
        link = self._sessions.new_link().removeprefix(HERE)
        answer = self._auth.answer(URL(f"{link}&card={card}", encoded=True), CIMultiDict({"Host": "127.0.0.1:8080"}))
        assert isinstance(answer, web.Response)
        return answer.headers["Location"]

    def get(self, path: str, session: SignIn, **headers: str) -> web.Response | SignedIn:
        cookie = f"{self._site.cookie}={session.cookie}"
        return self._auth.answer(URL(path), CIMultiDict({"Host": "127.0.0.1:8080", "Cookie": cookie, **headers}))

    def nonce(self, session: SignIn, mine: str = "mine") -> tuple[str, str]:
        """The console's, and its proof."""
        answer = self.get(f"/session?nonce={mine}", session)
        assert isinstance(answer, web.Response)
        assert answer.text is not None
        found = json.loads(answer.text)
        assert session.key not in answer.text
        return found["nonce"], found["proof"]

    def comes_in(self, session: SignIn, shown: str) -> bool:
        return isinstance(self.get(f"/ws?{shown}", session, Origin=HERE), SignedIn)


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
    made = f"nonce={nonce}&proof={proof(hashed(session.key), f'page {nonce}')}"
    assert visitor.comes_in(session, made)
    assert not visitor.comes_in(session, made), "a nonce serves once"


def test_what_is_no_proof_lets_nobody_in(visitor: Visitor) -> None:
    session, other = visitor.sign_in(), visitor.sign_in()
    made = proof(hashed(session.key), "page ")
    for shown in (
        "",
        "nonce=",
        "nonce=&proof=",
        f"nonce=&proof={made}",
        f"key={session.key}",
        f"nonce=\u00e4&proof={made}",
    ):
        assert not visitor.comes_in(session, shown)
    for shown in ("\u00e4", "", session.key):
        nonce, _ = visitor.nonce(session)
        assert not visitor.comes_in(session, f"nonce={nonce}&proof={shown}")
    for key, text in (
        (other.key, "page {}"),
        (session.key, "console mine {}"),
        (session.cookie, "page {}"),
        ("", "page {}"),
    ):
        nonce, _ = visitor.nonce(session)
        assert not visitor.comes_in(session, f"nonce={nonce}&proof={proof(hashed(key), text.format(nonce))}")
    nonce, shown = visitor.nonce(session, "page")
    assert not visitor.comes_in(session, f"nonce={nonce}&proof={shown}"), (
        "the console's own proof is none of the page's"
    )


def test_a_nonce_serves_for_a_short_time(visitor: Visitor) -> None:
    session = visitor.sign_in()
    late, early = (
        f"nonce={nonce}&proof={proof(hashed(session.key), f'page {nonce}')}"
        for nonce, _ in (visitor.nonce(session), visitor.nonce(session))
    )
    visitor.now_ns += NONCE_NS - 1
    assert visitor.comes_in(session, early)
    visitor.now_ns += 1
    assert not visitor.comes_in(session, late)
