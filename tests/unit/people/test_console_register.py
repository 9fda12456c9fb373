"""Links that work once, and the sessions that follow from them."""

import os
import resource
import stat
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.people.console.sessions import LINK_S, MAX_ENTRIES, SESSION_S, Register, SignIn, begun, revoke_all

URL = "http://127.0.0.1:8080"


class Clock:
    """A wall clock that somebody sets."""

    def __init__(self) -> None:
        self.now_s = 1_700_000_000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def register(tmp_path: Path, clock: Clock) -> Register:
    found = Register(tmp_path, 8080, clock)
    found.begin(URL, "operator")
    return found


def token_of(link: str) -> str:
    assert link.startswith(f"{URL}/?token=")
    return link.partition("token=")[2]


def sign_in(register: Register) -> str:
    """The cookie of a new session."""
    return new_session(register).cookie


def new_session(register: Register) -> SignIn:
    found = register.exchange(token_of(register.new_link()))
    assert found is not None
    return found


def test_a_link_works_once(register: Register) -> None:
    register.begin(URL, "observer")
    token = token_of(register.new_link())
    found = register.exchange(token)
    assert found is not None
    assert found.entry.role == "observer"
    assert register.cookie(found.cookie) == found.entry
    assert register.exchange(token) is None
    assert register.cookie(token) is None, "a link is no session"
    assert register.exchange(found.cookie) is None, "a session is no link"


def test_a_session_is_found_by_its_cookie_and_not_by_its_key(register: Register) -> None:
    mine = new_session(register)
    assert register.cookie(mine.cookie) == mine.entry
    for other in (None, "", mine.key, mine.entry.sha256):
        assert register.cookie(other) is None


def test_a_link_is_void_once_the_console_is_started_again(register: Register) -> None:
    token, session = token_of(register.new_link()), new_session(register)
    register.begin(URL, "operator")
    assert register.exchange(token) is None
    assert register.cookie(session.cookie) is not None, "a restart signs nobody out"


def test_sessions_are_of_one_certificate(register: Register) -> None:
    """A console may not be connected when its certificate is revoked, and later have another."""
    register.begin(URL, "operator", "operator-00")
    session = new_session(register)
    register.begin(URL, "operator", "operator-00")
    assert register.still_valid(session.entry), "a restart signs nobody out"
    register.begin(URL, "operator", "operator-01")
    assert not register.still_valid(session.entry)
    register.begin(URL, "operator", "operator-00")
    assert not register.still_valid(session.entry), "it is over for good"


@pytest.mark.parametrize("token", [None, "", "x", "\ud800", "0" * 43])
def test_what_is_no_session(register: Register, token: str | None) -> None:
    sign_in(register)
    assert register.cookie(token) is None


def test_a_page_that_only_looks_goes_on_so(register: Register) -> None:
    """Also at a console that is started again for operators."""
    register.begin(URL, "observer")
    found = register.exchange(token_of(register.new_link()))
    assert found is not None
    register.begin(URL, "operator")
    entry = register.cookie(found.cookie)
    assert entry is not None
    assert entry.role == "observer"


def test_a_link_becomes_too_old(register: Register, clock: Clock) -> None:
    token = token_of(register.new_link())
    clock.now_s += LINK_S
    assert register.exchange(token) is None


def test_a_session_ends(register: Register, clock: Clock) -> None:
    token = sign_in(register)
    entry = register.cookie(token)
    assert entry is not None
    clock.now_s += SESSION_S - 1
    assert register.still_valid(entry)
    clock.now_s += 1
    assert not register.still_valid(entry)
    assert register.cookie(token) is None


def test_what_seems_to_come_from_the_future_is_void(register: Register, clock: Clock) -> None:
    """A robot without a clock of its own starts in the past; a session must not live for years by that."""
    token = sign_in(register)
    clock.now_s -= 3600
    assert register.cookie(token) is None


def test_another_process_knows_the_session_and_revokes_it(register: Register, tmp_path: Path, clock: Clock) -> None:
    token = sign_in(register)
    link = register.new_link()
    other = Register(tmp_path, 8080, clock)
    entry = other.cookie(token)
    assert entry is not None
    assert revoke_all(tmp_path, clock) == 1
    assert not register.still_valid(entry)
    assert register.cookie(token) is None
    assert register.exchange(token_of(link)) is None
    sign_in(register)  # and it goes on


def test_the_port_has_its_own(register: Register, tmp_path: Path, clock: Clock) -> None:
    token = sign_in(register)
    other = Register(tmp_path, 8081, clock)
    assert other.cookie(token) is None
    with pytest.raises(ConfigError, match="no console has run there"):
        other.new_link()


def test_the_file_holds_no_token_and_is_private(register: Register, tmp_path: Path) -> None:
    token = sign_in(register)
    link = token_of(register.new_link())
    file = tmp_path / "console-8080.json"
    assert token not in file.read_text()
    assert link not in file.read_text()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"sessions": 3}', b'{"sessions": [{"sha256": ""}]}', b"\xff"])
def test_a_faulty_file_lets_nobody_in(register: Register, tmp_path: Path, content: bytes) -> None:
    token = sign_in(register)
    (tmp_path / "console-8080.json").write_bytes(content)
    assert register.cookie(token) is None
    register.begin(URL, "operator")
    assert register.cookie(sign_in(register)) is not None


def test_it_is_bounded(register: Register) -> None:
    first = sign_in(register)
    for _ in range(MAX_ENTRIES):
        newest = sign_in(register)
    assert register.cookie(first) is None
    assert register.cookie(newest) is not None


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write"):
        Register(tmp_path / "file", 8080).begin(URL, "operator")


def test_consoles_that_have_begun_the_latest_first(tmp_path: Path, clock: Clock) -> None:
    """A file without an address, or of another name, is no console's."""
    for port, written_s in ((8080, 1), (8443, 3), (9000, 2)):
        Register(tmp_path, port, clock).begin(f"https://robot.local:{port}", "operator")
        os.utime(tmp_path / f"console-{port}.json", (written_s, written_s))
    (tmp_path / "console-7.json").write_text("{}")
    (tmp_path / "console-x.json").write_text("{}")
    assert begun(tmp_path) == [(port, f"https://robot.local:{port}") for port in (8443, 9000, 8080)]


def test_without_a_free_descriptor_who_is_signed_in_stays_so_and_nobody_else_comes_in(
    register: Register, clock: Clock
) -> None:
    """Strangers can take the last one; the file of the sessions may have changed just before."""
    before = new_session(register)
    assert register.still_valid(before.entry)
    register.new_link()
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, limits[1]))
    try:
        with pytest.raises(OSError, match="Too many open files"):
            register.path.open()
        assert register.still_valid(before.entry)
        with pytest.raises(ConfigError, match="Too many open files"):
            register.new_link()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert register.still_valid(before.entry)
    revoke_all(register.path.parent, clock)
    assert not register.still_valid(before.entry)
