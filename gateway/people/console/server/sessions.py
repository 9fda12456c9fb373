"""Links that work once, and the sessions that browsers exchange them for.

They are kept in a file, so a console that is started again knows its pages, and `console --link` and `--sign-out` reach
the one that runs. The file holds only the SHA-256 of each random token; that of a session's key serves to check a
page's proof, and opens nothing without the cookie.

They end by the time since the boot, so a wall clock that is set (a Raspberry Pi has no battery for it) signs nobody
out, and STOP ALL stays in reach. Only how long a reboot took is by the wall clock, where that has not gone back.
"""

import hashlib
import os
import secrets
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple, Self

from pydantic import BaseModel

from gateway.errors import ConfigError
from gateway.files import durable
from gateway.people.console.pages.page_messages import Role, least

SESSION_S: Final = 12 * 3600
LINK_S: Final = 600
"""The life of an unused link: others may see the terminal that shows the link."""
MAX_ENTRIES: Final = 256
"""Most sessions, and most links; beyond these the oldest are dropped."""
MAX_SESSIONS_BYTES: Final = 1_000_000


class Now(NamedTuple):
    """The boot's id, the time since it, which nobody sets, and the wall clock."""

    boot: str = ""
    boot_s: float = 0.0
    wall_s: float = 0.0


def clocks() -> Now:
    """Return the present times. Outside Linux no boot has an id, and the wall clock counts as the time since it."""
    wall_s = time.time()
    has_boots = _boot() and hasattr(time, "CLOCK_BOOTTIME")
    return Now(_boot(), time.clock_gettime(time.CLOCK_BOOTTIME) if has_boots else wall_s, wall_s)


@cache
def _boot() -> str:
    """Return the boot's id, read once: later a flood may have taken the last descriptor. The unit passes it on."""
    with suppress(OSError):
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip().replace("-", "")
    return os.environ.get("BOOT_ID", "")


class Entry(BaseModel, frozen=True):
    """A link or a session: the SHA-256 of its token (a session's is its cookie) and of its key (a link's: empty)."""

    sha256: str
    key_sha256: str = ""
    role: Role
    until_s: float
    """When it ends, by the time since the boot in which it was written."""


class _Entries(BaseModel):
    before_token: str = ""
    role: Role = "observer"
    """The most rights that its pages get."""
    common_name: str = ""
    """The common name of its certificate; empty: it had none."""
    written: Now = Now()
    links: list[Entry] = []
    sessions: list[Entry] = []

    def at(self, now: Now) -> Self:
        """Return a copy without ended entries. A reboot ends all links; sessions count the time since the boot."""
        links, sessions = self.links, self.sessions
        if now.boot != self.written.boot:
            later_s = now.boot_s - self.written.boot_s - max(0.0, now.wall_s - self.written.wall_s)
            links = []
            sessions = [each.model_copy(update={"until_s": each.until_s + later_s}) for each in sessions]
        links, sessions = ([each for each in kind if now.boot_s < each.until_s] for kind in (links, sessions))
        newest = {"links": links[-MAX_ENTRIES:], "sessions": sessions[-MAX_ENTRIES:]}
        return self.model_copy(update={"written": now, **newest})


class Sessions:
    """The links and sessions of the console at one port. For any thread and process."""

    def __init__(self, folder: Path, port: int, now: Callable[[], Now] = clocks) -> None:
        self.port = port
        self.path = folder / f"console-{port}.json"
        self._now = now
        self._known: tuple[tuple[int, int, int] | None, _Entries] = None, _Entries()
        """The file's inode, time and size, and its content: one tuple, since several threads read it."""

    def begin(self, before_token: str, role: Role, common_name: str = "") -> None:
        """Begin a console whose pages have `role` at most; earlier links are void. Raises ConfigError.

        Sessions of another certificate (`common_name`) end: it may have been revoked while this console was not
        connected, and its sessions must not reach the robot by the certificate that replaces it.
        """
        with self._changing() as entries:
            if entries.common_name != common_name:
                entries.sessions.clear()
            entries.links.clear()
            entries.before_token, entries.role, entries.common_name = before_token, role, common_name

    @property
    def before_token(self) -> str:
        """The beginning of the links of the console that runs, or last ran, at this port; empty: none ran."""
        return self._read().before_token

    def new_link(self, card: str = "") -> str:
        """Return a link that works once, to the page's start or to `card`. Raises ConfigError, also if none ran."""
        if not self.before_token:
            raise ConfigError(f"no console has run there: {self.path} is missing; start one, or name its --listen")
        token = secrets.token_urlsafe(32)
        with self._changing() as entries:
            until_s = entries.written.boot_s + LINK_S
            entries.links.append(Entry(sha256=_sha256(token), role=entries.role, until_s=until_s))
        return f"{entries.before_token}{token}{card and f',{card}'}"

    def exchange(self, token: str) -> tuple[str, str] | None:
        """Exchange a link's token for a new session's cookie and key, and void the link.

        None if no valid link has the token.
        """
        if _find(self._read().links, token) is None:  # nothing is written for an unknown token
            return None
        cookie, key = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        with self._changing() as entries:
            link = _find(entries.links, token)
            if link is None:  # another process has exchanged it meanwhile
                return None
            until_s = entries.written.boot_s + SESSION_S
            entry = Entry(sha256=_sha256(cookie), key_sha256=_sha256(key), role=link.role, until_s=until_s)
            entries.links.remove(link)
            entries.sessions.append(entry)
        return cookie, key

    def cookie(self, cookie: str) -> Entry | None:
        """Return the cookie's valid session. It gives access to the page's files; the WebSocket requires the key."""
        known = self._read()
        found = _find(known.sessions, cookie)
        return found and found.model_copy(update={"role": least(found.role, known.role)})

    def still_valid(self, session: Entry) -> bool:
        """Return whether the session has neither ended nor been revoked."""
        return any(each.sha256 == session.sha256 for each in self._read().sessions)

    def revoke(self) -> int:
        """End all sessions and links; returns how many sessions there were. Raises ConfigError."""
        with self._changing() as entries:
            ended = len(entries.sessions)
            entries.links, entries.sessions = [], []
        return ended

    def _read(self) -> _Entries:
        """Return the file's valid entries; a missing or faulty file has none, so it signs nobody in.

        If the file exists and cannot be opened (a flood of connections has taken the last descriptor), its last known
        content counts: a person who is signed in must be able to press STOP ALL just then.
        """
        with suppress(OSError):
            found = self.path.stat() if self.path.exists() else None
            seen = found and (found.st_ino, found.st_mtime_ns, found.st_size)
            if seen != self._known[0]:
                self._known = seen, self._load()
        return self._known[1].at(self._now())

    def _load(self) -> _Entries:
        """Raises OSError."""
        with suppress(ValueError):  # no file, or a faulty one
            return _Entries.model_validate_json(durable.read(self.path, MAX_SESSIONS_BYTES) or b"")
        return _Entries()

    @contextmanager
    def _changing(self) -> Iterator[_Entries]:
        """The valid entries; the file gets what the block makes of them. Raises ConfigError."""
        try:
            self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with durable.locked(self.path):
                entries = self._load().at(self._now())
                yield entries
                durable.write_like_the_folder(self.path, entries.model_dump_json().encode(), 0o600)
        except OSError as error:
            raise ConfigError(
                f"cannot write {self.path}: {error.strerror}; the console keeps its sessions there, "
                "so make the folder writable or name another (STATE_DIRECTORY)"
            ) from error


def kept(folder: Path) -> list[Sessions]:
    """Return the sessions of all consoles that began with this folder, the latest first."""
    paths = sorted(folder.glob("console-*.json"), key=lambda path: path.stat().st_mtime_ns, reverse=True)
    return [Sessions(folder, int(port)) for path in paths if (port := path.stem.removeprefix("console-")).isdigit()]


def _find(entries: Sequence[Entry], token: str) -> Entry | None:
    """Compares SHA-256 values, so the time that it takes shows nothing about a token."""
    wanted = _sha256(token)
    return next((entry for entry in entries if entry.sha256 == wanted), None)


def _sha256(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()
