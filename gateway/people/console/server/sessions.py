"""Links that work once, and the sessions that browsers exchange them for.

They are kept in a file, so a console that is started again knows its pages, and `console --link` and `--sign-out` reach
the one that runs. The file holds only the SHA-256 of each random token; that of a session's key serves to check a
page's proof, and opens nothing without the cookie.

Ages are by the time since the boot, so a wall clock that is set (a Raspberry Pi has no battery for it) signs nobody
out, and STOP ALL stays in reach. Only across a reboot an age is by the wall clock, where that has not gone back.
"""

import hashlib
import importlib
import os
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from gateway import durable
from gateway.errors import ConfigError
from gateway.people.console.pages.page_messages import Role
from gateway.people.console.server.site import STATE_DIRECTORY

SESSION_S: Final = 12 * 3600
LINK_S: Final = 600
"""Of a link that is not used: others may see the terminal in which it stands."""
MAX_ENTRIES: Final = 256
"""Of sessions, and of links; beyond these the oldest are dropped."""
MAX_SESSIONS_BYTES: Final = 1_000_000
_LOCK_FLAGS: Final = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0)
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")


class Now(NamedTuple):
    """The time since this boot, which nobody sets; the boot's id ("": the system tells none); and the wall clock."""

    boot: str
    boot_s: float
    wall_s: float


def clocks() -> Now:
    """As they are."""
    try:
        return Now(_BOOT_ID.read_text().strip(), time.clock_gettime(time.CLOCK_BOOTTIME), time.time())
    except (OSError, AttributeError):  # not on Linux
        return Now("", 0.0, time.time())


class Entry(BaseModel):
    """A link or a session: the SHA-256 of its token (a session's is its cookie) and of its key."""

    model_config = ConfigDict(frozen=True)
    sha256: str
    key_sha256: str = ""
    """Empty for a link, and for a session of an earlier version, which no key fits."""
    role: Role
    created_s: float
    """By the wall clock."""
    boot: str = ""
    boot_s: float = 0.0
    """In which boot it was created, and when."""
    lives_s: float

    def age_s(self, now: Now) -> float:
        """Of an entry from the wall clock's future: 0."""
        return now.boot_s - self.boot_s if self.is_of(now) else max(0.0, now.wall_s - self.created_s)

    def is_of(self, now: Now) -> bool:
        """Whether it was created in this boot."""
        return bool(now.boot) and self.boot == now.boot

    def is_valid(self, now: Now) -> bool:
        """Whether it has begun and not ended."""
        return 0 <= self.age_s(now) < self.lives_s

    def in_this_boot(self, now: Now) -> Self:
        """The same, from now on by the time since this boot."""
        return self.model_copy(update={"boot": now.boot, "boot_s": now.boot_s - self.age_s(now)})


@dataclass(frozen=True)
class SignIn:
    """A new session: the browser's two secrets, and its entry."""

    cookie: str
    key: str
    entry: Entry


class _Entries(BaseModel):
    model_config = ConfigDict(frozen=True)
    url: str = ""
    """Of the console that runs, or last ran, at this port."""
    door: str = ""
    """What its links begin with, before the token, where they lead to a page without TLS first."""
    role: Role = "observer"
    common_name: str = ""
    """Of its certificate; empty: it had none."""
    links: tuple[Entry, ...] = ()
    sessions: tuple[Entry, ...] = ()


class Sessions:
    """The links and sessions of the console at one port. For any thread and process."""

    def __init__(self, folder: Path, port: int, now: Callable[[], Now] = clocks) -> None:
        self.path = folder / f"console-{port}.json"
        """Where they are kept."""
        self._now = now
        self._known: tuple[tuple[int, int, int] | None, _Entries] = None, _Entries()
        """The file's inode, time and size, and its content: one tuple, since several threads read it."""

    def begin(self, url: str, role: Role, common_name: str = "", door: str = "") -> None:
        """Begin a console at `url`: its links open pages of `role`, earlier links are void. Raises ConfigError.

        Sessions of another certificate (`common_name`) end: it may have been revoked while this console was not
        connected, and its sessions must not reach the robot by the certificate that replaces it.
        """

        def begun(now: _Entries) -> _Entries:
            sessions = now.sessions if now.common_name == common_name else ()
            return _Entries(url=url, door=door, role=role, common_name=common_name, sessions=sessions)

        self._change(begun)

    @property
    def url(self) -> str:
        """Of the console that runs, or last ran, at this port; empty: none did."""
        return self._read().url

    def new_link(self, card: str = "") -> str:
        """A link that works once, to the page's beginning or this card of it.

        Raises ConfigError if no console has begun, or the folder cannot be written.
        """
        if not self._read().url:
            raise ConfigError(f"no console has run there: {self.path} is missing; start one, or name its --listen")
        token = secrets.token_urlsafe(32)

        def add(now: _Entries) -> _Entries:
            entry = self._entry(token, now.role, LINK_S)
            return now.model_copy(update={"links": (*now.links, entry)[-MAX_ENTRIES:]})

        made = self._change(add)
        if made.door:
            return f"{made.door}{token}{card and f',{card}'}"
        return f"{made.url}/?token={token}{card and f'&card={card}'}"

    def exchange(self, token: str) -> SignIn | None:
        """A new session for a link's token, which is void from now on; None if no valid link has this token."""
        found = _find(_links(self._read(), self._now()), token)
        if found is None:
            return None
        cookie, key = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        entry = self._entry(cookie, found.role, SESSION_S, key)

        def enter(now: _Entries) -> _Entries:
            if found not in now.links:
                return now
            links = tuple(link for link in now.links if link != found)
            return now.model_copy(update={"links": links, "sessions": (*now.sessions, entry)[-MAX_ENTRIES:]})

        before = self._change(enter)
        return SignIn(cookie, key, entry) if found in before.links else None  # another process has exchanged it

    def cookie(self, cookie: str | None) -> Entry | None:
        """The valid session of this cookie. It gives access to the page's files; the WebSocket requires the key too."""
        return None if cookie is None else _find(_sessions(self._read(), self._now()), cookie)

    def still_valid(self, session: Entry) -> bool:
        """Whether it has neither ended nor been revoked."""
        return session.is_valid(self._now()) and session in self._read().sessions

    def revoke(self) -> int:
        """End all sessions and links; returns how many sessions there were."""
        before = self._change(lambda now: now.model_copy(update={"links": (), "sessions": ()}))
        return len(before.sessions)

    def _entry(self, token: str, role: Role, lives_s: float, key: str = "") -> Entry:
        hashed, (boot, boot_s, created_s) = key and _sha256(key), self._now()
        return Entry(
            sha256=_sha256(token), key_sha256=hashed, role=role, lives_s=lives_s,
            created_s=created_s, boot=boot, boot_s=boot_s,
        )  # fmt: skip

    def _read(self) -> _Entries:
        """The file's content; a missing or faulty file has no entries, so it signs nobody in.

        If the file exists and cannot be opened (a flood of connections has taken the last descriptor), its last known
        content counts: a person who is signed in must be able to press STOP ALL just then.
        """
        seen, entries = self._known
        try:
            found = self.path.stat()
            now = (found.st_ino, found.st_mtime_ns, found.st_size)
            if now != seen:
                self._known = now, (entries := self._load())
        except FileNotFoundError:
            self._known = None, (entries := _Entries())
        except OSError:
            pass
        return entries

    def _load(self) -> _Entries:
        """Raises OSError, also if there is no file."""
        with self.path.open("rb") as file:
            content = file.read(MAX_SESSIONS_BYTES)
        try:
            return _Entries.model_validate_json(content)
        except ValidationError:
            return _Entries()

    def _change(self, change: Callable[[_Entries], _Entries]) -> _Entries:
        """Replace the valid entries by what `change` returns for them; returns those before. Raises ConfigError.

        A lock on a second file excludes other processes and threads meanwhile.
        """
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with os.fdopen(os.open(self.path.with_suffix(".lock"), _LOCK_FLAGS, 0o600)) as lock:
                durable.like_the_folder(self.path, lock.fileno())
                _lock(lock.fileno())
                now = self._now()
                found = self._load() if self.path.exists() else _Entries()
                before = found.model_copy(update={"links": _links(found, now), "sessions": _sessions(found, now)})
                write_private(self.path, change(before).model_dump_json())
        except OSError as error:
            raise ConfigError(
                f"cannot write {self.path}: {error.strerror}; the console keeps its sessions there, "
                "so make the folder writable or name another (STATE_DIRECTORY)"
            ) from error
        return before


def _lock(descriptor: int) -> None:
    """Wait for the lock; it ends with the descriptor. Raises OSError."""
    try:
        import fcntl  # noqa: PLC0415
    except ImportError:  # Windows
        windows: Any = importlib.import_module("msvcrt")
        windows.locking(descriptor, windows.LK_LOCK, 1)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX)


def write_private(path: Path, content: str) -> None:
    """Replace a file that only the folder's owner may read. Raises OSError.

    It gets the folder's owner, so `sudo hexapod-gateway console --link` does not lock the service out.
    """
    durable.write_with_mode(path, content.encode(), 0o600, prepare=partial(durable.like_the_folder, path))


def folder() -> Path:
    """Where the files are kept: the service's state directory, or the user's."""
    if given := os.environ.get("STATE_DIRECTORY"):
        return Path(given.partition(":")[0])
    if hasattr(os, "geteuid") and os.geteuid() == 0 and STATE_DIRECTORY.is_dir():
        return STATE_DIRECTORY
    home = os.environ.get("XDG_STATE_HOME")
    return (Path(home) if home else Path.home() / ".local" / "state") / "hexapod-gateway"


def begun(folder: Path) -> list[tuple[int, str]]:
    """Port and URL of the consoles with a file in this folder, the newest file first."""
    return [(port, url) for port in _ports(folder) if (url := Sessions(folder, port).url)]


def revoke_all(folder: Path) -> int:
    """End the sessions of all consoles with a file in this folder; returns how many there were."""
    return sum(Sessions(folder, port).revoke() for port in _ports(folder))


def _ports(folder: Path) -> list[int]:
    paths = sorted(folder.glob("console-*.json"), key=lambda path: path.stat().st_mtime_ns, reverse=True)
    return [int(number) for path in paths if (number := path.stem.removeprefix("console-")).isdigit()]


def _links(entries: _Entries, now: Now) -> tuple[Entry, ...]:
    """Those that open a page: none of an earlier boot, after which a link's age is not sure."""
    return tuple(link for link in entries.links if link.is_valid(now) and (link.is_of(now) or not now.boot))


def _sessions(entries: _Entries, now: Now) -> tuple[Entry, ...]:
    """Those that have not ended."""
    return tuple(each if each.is_of(now) else each.in_this_boot(now) for each in entries.sessions if each.is_valid(now))


def _find(entries: tuple[Entry, ...], token: str) -> Entry | None:
    """Compares SHA-256 values, so the time that it takes shows nothing about a token."""
    wanted = _sha256(token)
    return next((entry for entry in entries if entry.sha256 == wanted), None)


def _sha256(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()
