"""How a page and its console show each other that they know the session's key, which neither sends."""

import asyncio
import json
import os
import re
import resource
import stat
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import pytest
from aiohttp import web
from multidict import CIMultiDict
from yarl import URL

from gateway.errors import ConfigError
from gateway.people.console.server.auth import NONCE_NS, Auth, proof
from gateway.people.console.server.sessions import LINK_S, SESSION_S, Entry, Now, Sessions, kept
from gateway.people.console.server.site import site

HERE = "http://127.0.0.1:8080"
START = f"{HERE}/?token="


class SignIn(NamedTuple):
    """A new session: the browser's two secrets, and its entry."""

    cookie: str
    key: str
    entry: Entry


class Visitor:
    """A browser's requests at the door of a console, in virtual time."""

    def __init__(self, sessions: Sessions, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns = 100_000_000_000
        monkeypatch.setattr("gateway.people.console.server.auth.time.monotonic_ns", lambda: self.now_ns)
        self._site = site("127.0.0.1:8080", None, None)
        self._auth = Auth(self._site, sessions)

    def get(self, path: str, session: SignIn, **headers: str) -> web.Response | Entry:
        return self.ask(URL(path), **{"Cookie": f"{self._site.cookie_at(None)}={session.cookie}", **headers})

    def ask(self, url: URL, **headers: str) -> web.Response | Entry:
        return asyncio.run(self._auth.answer(url, CIMultiDict({"Host": "127.0.0.1:8080", **headers})))

    def nonce(self, session: SignIn, mine: str = "mine") -> tuple[str, str]:
        """Return the console's nonce, and its proof."""
        answer = self.get(f"/session?nonce={mine}", session)
        assert isinstance(answer, web.Response)
        assert answer.text is not None
        found = json.loads(answer.text)
        assert session.key not in answer.text
        return found["nonce"], found["proof"]

    def proved(self, session: SignIn) -> str:
        """Return what a page with the session's key offers for its WebSocket."""
        nonce, _ = self.nonce(session)
        return f"nonce={nonce}&proof={proof(hashed(session.key), f'page {nonce}')}"

    def comes_in(self, session: SignIn, shown: str, **headers: str) -> bool:
        return isinstance(self.get(f"/ws?{shown}", session, **{"Origin": HERE, **headers}), Entry)

    def status(self, path: str, session: SignIn, **headers: str) -> int:
        answer = self.get(path, session, **headers)
        assert isinstance(answer, web.Response)
        return answer.status


@pytest.fixture
def visitor(sessions: Sessions, monkeypatch: pytest.MonkeyPatch) -> Visitor:
    return Visitor(sessions, monkeypatch)


def hashed(key: str) -> str:
    return sha256(key.encode()).hexdigest()


@pytest.mark.parametrize(
    ("card", "behind"),
    [("cal", "?cal"), ("", ""), ("x%0d%0aSet-Cookie:%20a", ""), ("%C3%A4", ""), ("/evil.example", "")],
)
def test_a_link_leads_to_a_card_and_nowhere_else(visitor: Visitor, sessions: Sessions, card: str, behind: str) -> None:
    link = sessions.new_link().removeprefix(HERE)
    answer = visitor.ask(URL(f"{link},{card}", encoded=True))
    assert isinstance(answer, web.Response)
    assert re.fullmatch(rf"/enter.html{re.escape(behind)}#[\w-]+", answer.headers["Location"])


def test_each_shows_the_other_that_it_knows_the_key(visitor: Visitor, sessions: Sessions) -> None:
    session = new_session(sessions)
    nonce, shown = visitor.nonce(session)
    assert shown == proof(hashed(session.key), f"console mine {nonce}")
    made = visitor.proved(session)
    assert visitor.comes_in(session, made)
    assert not visitor.comes_in(session, made), "a nonce serves once"


@pytest.mark.parametrize("origin", ["", "https://127.0.0.1:8080", "http://127.0.0.1:80801", "http://localhost:8080"])
def test_foreign_origins(visitor: Visitor, sessions: Sessions, origin: str) -> None:
    """Another page on this machine is as foreign as any: its origin has another port, scheme or name."""
    session = new_session(sessions)
    made = visitor.proved(session)
    assert not visitor.comes_in(session, made, Origin=origin)
    assert visitor.status("/", session, Origin=origin) == 403
    assert visitor.status(f"/ws?{made}", session) == 403, "a browser states a WebSocket's origin"
    assert visitor.status("/", session) == visitor.status("/", session, Origin=HERE) == 200
    assert visitor.comes_in(session, made), "the nonce is not used up"


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8080", "127.0.0.1.evil.example:8080", "127.0.0.1", ""])
def test_a_foreign_name_that_points_here_gets_nothing(visitor: Visitor, sessions: Sessions, host: str) -> None:
    """DNS rebinding: not even with the cookie, or a link."""
    session, link = new_session(sessions), sessions.new_link().removeprefix(HERE)
    assert visitor.status("/", session, Host=host) == visitor.status(link, session, Host=host) == 403
    assert visitor.status(link, session) == 303


def test_a_tunnel_at_another_port_needs_its_own_sign_in(visitor: Visitor, sessions: Sessions) -> None:
    session, tunnel = new_session(sessions), "127.0.0.1:8081"
    assert visitor.status("/", session, Host=tunnel) == 403, "the cookie is of another port"
    entered = visitor.get(sessions.new_link().removeprefix(HERE), session, Host=tunnel)
    assert isinstance(entered, web.Response)
    ((name, made),) = entered.cookies.items()
    assert name == "hexapod-console-8081"
    there = {"Host": tunnel, "Cookie": f"{name}={made.value}"}
    assert visitor.status("/", session, **there) == 200
    for origin in (HERE, "http://localhost:8081", "null"):
        assert visitor.status("/", session, **there, Origin=origin) == 403


def test_what_is_no_proof_lets_nobody_in(visitor: Visitor, sessions: Sessions) -> None:
    session, other = new_session(sessions), new_session(sessions)
    made = proof(hashed(session.key), "page ")
    empty = ("", "nonce=", "nonce=&proof=", f"nonce=&proof={made}")
    for shown in (*empty, f"key={session.key}", f"nonce=\u00e4&proof={made}"):
        assert not visitor.comes_in(session, shown)
    for shown in ("\u00e4", "", session.key):
        nonce, _ = visitor.nonce(session)
        assert not visitor.comes_in(session, f"nonce={nonce}&proof={shown}")
    for key in (other.key, session.cookie, ""):
        nonce, _ = visitor.nonce(session)
        assert not visitor.comes_in(session, f"nonce={nonce}&proof={proof(hashed(key), f'page {nonce}')}")
    nonce, shown = visitor.nonce(session, "page")
    assert not visitor.comes_in(session, f"nonce={nonce}&proof={shown}"), "the console's own proof is not the page's"


def test_a_nonce_serves_for_a_short_time(visitor: Visitor, sessions: Sessions) -> None:
    session = new_session(sessions)
    late, early = visitor.proved(session), visitor.proved(session)
    visitor.now_ns += NONCE_NS - 1
    assert visitor.comes_in(session, early)
    visitor.now_ns += 1
    assert not visitor.comes_in(session, late)


# ---- sessions and links


class Clock:
    """A machine's clocks; somebody may set the one on its wall, or start it anew."""

    def __init__(self) -> None:
        self.boot, self.boot_s, self.wall_s = "first", 100.0, 1_700_000_000.0

    def __call__(self) -> Now:
        return Now(self.boot, self.boot_s, self.wall_s)

    def passes(self, seconds: float) -> None:
        self.boot_s += seconds
        self.wall_s += seconds


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def sessions(tmp_path: Path, clock: Clock) -> Sessions:
    found = Sessions(tmp_path, 8080, clock)
    found.begin(START, "operator")
    return found


def new_token(sessions: Sessions) -> str:
    """Return the token of a new link."""
    link = sessions.new_link()
    assert link.startswith(f"{HERE}/?token=")
    return link.partition("token=")[2]


def new_session(sessions: Sessions, token: str | None = None) -> SignIn:
    found = sessions.exchange(token or new_token(sessions))
    assert found is not None
    cookie, key = found
    entry = sessions.cookie(cookie)
    assert entry is not None
    return SignIn(cookie, key, entry)


def test_a_link_works_once_and_for_a_time(sessions: Sessions, clock: Clock) -> None:
    sessions.begin(START, "observer")
    token = new_token(sessions)
    found = new_session(sessions, token)
    assert found.entry.role == "observer"
    assert sessions.exchange(token) is None
    assert sessions.cookie(token) is None, "a link is no session"
    assert sessions.exchange(found.cookie) is None, "a session is no link"
    late = new_token(sessions)
    clock.passes(LINK_S)
    assert sessions.exchange(late) is None


def test_sessions_are_of_one_certificate(sessions: Sessions) -> None:
    """A console may not be connected when its certificate is revoked, and later have another."""
    sessions.begin(START, "operator", "operator-00")
    session = new_session(sessions)
    sessions.begin(START, "operator", "operator-00")
    assert sessions.still_valid(session.entry), "a restart signs nobody out"
    sessions.begin(START, "operator", "operator-01")
    assert not sessions.still_valid(session.entry)
    sessions.begin(START, "operator", "operator-00")
    assert not sessions.still_valid(session.entry), "it is over for good"


@pytest.mark.parametrize("step_s", [13 * 3600, -2 * 3600, 30 * 365 * 86400, -30 * 365 * 86400])
def test_a_clock_that_is_set_signs_nobody_out_and_shortens_no_link(
    sessions: Sessions, clock: Clock, step_s: float
) -> None:
    """A Raspberry Pi without a battery learns the time minutes after its start: who drives must keep STOP ALL."""
    session, token = new_session(sessions), new_token(sessions)
    clock.wall_s += step_s
    assert sessions.still_valid(session.entry)
    assert sessions.cookie(session.cookie) == session.entry
    assert sessions.exchange(token) is not None
    clock.passes(SESSION_S)
    assert not sessions.still_valid(session.entry)


@pytest.mark.parametrize(("wall_s", "lasts_s"), [(-7 * 86400, SESSION_S), (3600, SESSION_S - 3600), (SESSION_S, 0)])
def test_across_a_reboot_an_age_is_by_the_wall_clock_unless_that_went_back(
    sessions: Sessions, clock: Clock, wall_s: float, lasts_s: float
) -> None:
    cookie, token = new_session(sessions).cookie, new_token(sessions)
    clock.boot, clock.boot_s, clock.wall_s = "second", 5.0, clock.wall_s + wall_s
    assert sessions.exchange(token) is None, "how old a link is, nobody knows now"
    sessions.begin(START, "operator")
    entry = sessions.cookie(cookie)
    assert (entry is not None) is (lasts_s > 0)
    if entry is not None:
        clock.wall_s += 13 * 3600
        clock.boot_s += lasts_s - 1
        assert sessions.still_valid(entry)
        clock.boot_s += 1
        assert not sessions.still_valid(entry)


def test_the_port_has_its_own(sessions: Sessions, tmp_path: Path, clock: Clock) -> None:
    token = new_session(sessions).cookie
    other = Sessions(tmp_path, 8081, clock)
    assert other.cookie(token) is None
    with pytest.raises(ConfigError, match="no console has run there"):
        other.new_link()


def test_the_file_holds_no_token_and_is_private(sessions: Sessions, tmp_path: Path) -> None:
    session, link = new_session(sessions), new_token(sessions)
    file = tmp_path / "console-8080.json"
    assert not [secret for secret in (session.cookie, session.key, link) if secret in file.read_text()]
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"sessions": 3}', b'{"sessions": [{"sha256": ""}]}', b"\xff"])
def test_a_faulty_file_lets_nobody_in(sessions: Sessions, tmp_path: Path, content: bytes) -> None:
    token = new_session(sessions).cookie
    (tmp_path / "console-8080.json").write_bytes(content)
    assert sessions.cookie(token) is None
    sessions.begin(START, "operator")
    assert sessions.cookie(new_session(sessions).cookie) is not None


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write"):
        Sessions(tmp_path / "file", 8080).begin(START, "operator")


def test_consoles_that_have_begun_the_latest_first(tmp_path: Path, clock: Clock) -> None:
    """A file without an address, or of another name, is no console's."""
    for port, written_s in ((8080, 1), (8443, 3), (9000, 2)):
        Sessions(tmp_path, port, clock).begin(f"https://robot.local:{port}/?token=", "operator")
        os.utime(tmp_path / f"console-{port}.json", (written_s, written_s))
    (tmp_path / "console-7.json").write_text("{}")
    (tmp_path / "console-x.json").write_text("{}")
    begun = [(each.port, each.before_token) for each in kept(tmp_path) if each.before_token]
    assert begun == [(port, f"https://robot.local:{port}/?token=") for port in (8443, 9000, 8080)]


def test_without_a_free_descriptor_who_is_signed_in_stays_so_and_nobody_else_comes_in(sessions: Sessions) -> None:
    """Strangers can take the last one; the file of the sessions may have changed just before."""
    before = new_session(sessions)
    assert sessions.still_valid(before.entry)
    sessions.new_link()
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, limits[1]))
    try:
        with pytest.raises(OSError, match="Too many open files"):
            sessions.path.open()
        assert sessions.still_valid(before.entry)
        with pytest.raises(ConfigError, match="Too many open files"):
            sessions.new_link()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert sessions.still_valid(before.entry)
    for each in kept(sessions.path.parent):
        each.revoke()
    assert not sessions.still_valid(before.entry)
