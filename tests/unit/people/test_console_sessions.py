"""Links that work once, and the sessions that follow from them."""

import os
import resource
import stat
from pathlib import Path

import pytest

from gateway.errors import ConfigError
from gateway.people.console.server.sessions import LINK_S, SESSION_S, Now, Sessions, SignIn, kept

URL = "http://127.0.0.1:8080"


class Clock:
    """A machine's clocks; somebody may set the one on its wall, or start it anew."""

    def __init__(self) -> None:
        self.boot, self.boot_s, self.wall_s = "first", 100.0, 1_700_000_000.0

    def __call__(self) -> Now:
        return Now(self.boot, self.boot_s, self.wall_s)

    def passes(self, seconds: float) -> None:
        self.boot_s += seconds
        self.wall_s += seconds

    def reboots(self, wall_s: float) -> None:
        self.boot, self.boot_s, self.wall_s = "second", 5.0, wall_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def sessions(tmp_path: Path, clock: Clock) -> Sessions:
    found = Sessions(tmp_path, 8080, clock)
    found.begin(URL, "operator")
    return found


def token_of(link: str) -> str:
    assert link.startswith(f"{URL}/?token=")
    return link.partition("token=")[2]


def sign_in(sessions: Sessions) -> str:
    """The cookie of a new session."""
    return new_session(sessions).cookie


def new_session(sessions: Sessions) -> SignIn:
    found = sessions.exchange(token_of(sessions.new_link()))
    assert found is not None
    return found


def test_a_link_works_once(sessions: Sessions) -> None:
    sessions.begin(URL, "observer")
    token = token_of(sessions.new_link())
    found = sessions.exchange(token)
    assert found is not None
    assert found.entry.role == "observer"
    assert sessions.cookie(found.cookie) == found.entry
    assert sessions.exchange(token) is None
    assert sessions.cookie(token) is None, "a link is no session"
    assert sessions.exchange(found.cookie) is None, "a session is no link"


def test_sessions_are_of_one_certificate(sessions: Sessions) -> None:
    """A console may not be connected when its certificate is revoked, and later have another."""
    sessions.begin(URL, "operator", "operator-00")
    session = new_session(sessions)
    sessions.begin(URL, "operator", "operator-00")
    assert sessions.still_valid(session.entry), "a restart signs nobody out"
    sessions.begin(URL, "operator", "operator-01")
    assert not sessions.still_valid(session.entry)
    sessions.begin(URL, "operator", "operator-00")
    assert not sessions.still_valid(session.entry), "it is over for good"


def test_a_link_becomes_too_old(sessions: Sessions, clock: Clock) -> None:
    token = token_of(sessions.new_link())
    clock.passes(LINK_S)
    assert sessions.exchange(token) is None


def test_a_session_ends(sessions: Sessions, clock: Clock) -> None:
    token = sign_in(sessions)
    entry = sessions.cookie(token)
    assert entry is not None
    clock.passes(SESSION_S - 1)
    assert sessions.still_valid(entry)
    clock.passes(1)
    assert not sessions.still_valid(entry)
    assert sessions.cookie(token) is None


@pytest.mark.parametrize("step_s", [13 * 3600, -2 * 3600, 30 * 365 * 86400, -30 * 365 * 86400])
def test_a_clock_that_is_set_signs_nobody_out_and_shortens_no_link(
    sessions: Sessions, clock: Clock, step_s: float
) -> None:
    """A Raspberry Pi without a battery learns the time minutes after its start: who drives must keep STOP ALL."""
    session, token = new_session(sessions), token_of(sessions.new_link())
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
    cookie, token = sign_in(sessions), token_of(sessions.new_link())
    clock.reboots(clock.wall_s + wall_s)
    assert sessions.exchange(token) is None, "how old a link is, nobody knows now"
    sessions.begin(URL, "operator")
    entry = sessions.cookie(cookie)
    assert (entry is not None) is (lasts_s > 0)
    if entry is not None:
        clock.wall_s += 13 * 3600
        clock.boot_s += lasts_s - 1
        assert sessions.still_valid(entry)
        clock.boot_s += 1
        assert not sessions.still_valid(entry)


def test_the_port_has_its_own(sessions: Sessions, tmp_path: Path, clock: Clock) -> None:
    token = sign_in(sessions)
    other = Sessions(tmp_path, 8081, clock)
    assert other.cookie(token) is None
    with pytest.raises(ConfigError, match="no console has run there"):
        other.new_link()


def test_the_file_holds_no_token_and_is_private(sessions: Sessions, tmp_path: Path) -> None:
    token = sign_in(sessions)
    link = token_of(sessions.new_link())
    file = tmp_path / "console-8080.json"
    assert token not in file.read_text()
    assert link not in file.read_text()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"sessions": 3}', b'{"sessions": [{"sha256": ""}]}', b"\xff"])
def test_a_faulty_file_lets_nobody_in(sessions: Sessions, tmp_path: Path, content: bytes) -> None:
    token = sign_in(sessions)
    (tmp_path / "console-8080.json").write_bytes(content)
    assert sessions.cookie(token) is None
    sessions.begin(URL, "operator")
    assert sessions.cookie(sign_in(sessions)) is not None


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot write"):
        Sessions(tmp_path / "file", 8080).begin(URL, "operator")


def test_consoles_that_have_begun_the_latest_first(tmp_path: Path, clock: Clock) -> None:
    """A file without an address, or of another name, is no console's."""
    for port, written_s in ((8080, 1), (8443, 3), (9000, 2)):
        Sessions(tmp_path, port, clock).begin(f"https://robot.local:{port}", "operator")
        os.utime(tmp_path / f"console-{port}.json", (written_s, written_s))
    (tmp_path / "console-7.json").write_text("{}")
    (tmp_path / "console-x.json").write_text("{}")
    begun = [(each.port, each.url) for each in kept(tmp_path) if each.url]
    assert begun == [(port, f"https://robot.local:{port}") for port in (8443, 9000, 8080)]


def test_without_a_free_descriptor_who_is_signed_in_stays_so_and_nobody_else_comes_in(
    sessions: Sessions,
) -> None:
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
