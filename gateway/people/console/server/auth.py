"""Answers HTTP requests, without I/O. A request without a session is answered by 403, a reason, and nothing else.

A session has two secrets. Browsers send the cookie with every request, also to other ports of the same host, where
another user of the machine may listen. So it gives access to the page's files alone; the WebSocket also requires the
session's key, which the page keeps for its own origin (scheme, host and port).

The key is never sent, since another program may listen at this origin while the console is started again. The page
sends a nonce to `/session`; the answer has the console's nonce, and an HMAC over both proves that it knows the key.
Only then the page opens its WebSocket, with an HMAC over the console's nonce.
"""

import gzip
import hashlib
import hmac
import mimetypes
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs

from aiohttp import web
from multidict import MultiMapping

from gateway.people.console.pages.page_messages import Role, least
from gateway.people.console.server.sessions import Entry, Sessions
from gateway.people.console.server.site import Site

PAGE: Final = Path(__file__).parents[1] / "page"
WEBSOCKET: Final = "/ws"
SUBPROTOCOL: Final = "hexapod-console"
PROOF_PREFIX: Final = "proof."
"""A page offers it with the console's nonce and its HMAC as a second subprotocol: a script can set no other header of a
WebSocket's request."""
NONCE_S: Final = 10.0
"""How long a nonce may be used, once: a page opens its WebSocket as soon as it receives it."""
COOKIE_S: Final = 30 * 24 * 3600
"""Of a browser's cookie, by the browser's wall clock, which may be set, too; the session itself ends earlier."""
PACKED: Final = ".gz"
MAX_NONCES: Final = 256
"""As many as the bound on connections allows in five seconds; beyond these the oldest are dropped."""
PUBLIC: Final = ("/enter.html", "/enter.js", "/key.js", "/refused.css")
"""The first three move the key of a new session from the address into the browser's storage."""

CONTENT_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self' {socket}; "
    "manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
NEW_LINK: Final = "A link that works once is printed, on the console's machine, by:"
HEADERS: Final = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), gamepad=(self)",
    "cache-control": "no-cache",  # revalidated each time, and answered with 304 if unchanged
    "vary": "Accept-Encoding",
    "server": "hexapod-gateway",
}
_PAGES: Final = {"/": "/index.html", "/button": "/button.html"}


@dataclass(frozen=True)
class SignedIn:
    """A WebSocket request of a page with a session."""

    entry: Entry
    role: Role
    tab: str = ""
    """The browser's tab, by a name that it gave itself: the same after a reload. Empty: it gave none."""


@dataclass(frozen=True)
class PageFile:
    content: bytes
    packed: bytes
    """By gzip."""
    kind: str
    tag: str


class Auth:
    """Answer requests with the page's files, and check sessions. For one thread."""

    def __init__(self, site: Site, sessions: Sessions, role: Role) -> None:
        """`role`: what a page may do at most."""
        self._site = site
        self._sessions = sessions
        self._role = role
        self._files = read_files()
        self._nonces: dict[str, float] = {}
        """Issued and not used, and until when each is valid, monotonic."""

    def answer(self, method: str, target: str, headers: MultiMapping[str]) -> web.Response | SignedIn:
        """Return the response, or the session whose WebSocket is admitted.

        A response to a request without a session closes its connection.
        """
        path, _, query = target.partition("?")
        public = self._public(method, path, query, headers)
        if public is not None:
            public.force_close()
        found = self._for_session(headers, path, query) if public is None else public
        if isinstance(found, web.Response):
            host = _one(headers, "Host") or ""
            socket = f"{'wss' if self._site.certificate else 'ws'}://{host}" if self._site.knows_host(host) else ""
            found.headers.update(HEADERS, **{"content-security-policy": CONTENT_POLICY.format(socket=socket)})
        return found

    def _public(self, method: str, path: str, query: str, headers: MultiMapping[str]) -> web.Response | None:
        """The answer to a request that no page of ours sends, and to one that needs no session."""
        host, origin = _one(headers, "Host"), _one(headers, "Origin")
        if method != "GET":
            return _text(405, "only GET")
        if not self._site.knows_host(host):
            return _text(403, f"this console is at {self._site.url}, and not at the address that you gave")
        if (path == WEBSOCKET or "Origin" in headers) and not self._site.knows_origin(origin, host):
            return _text(403, "only the console's own page may come here")
        if path == "/" and (token := _given(query, "token")) is not None:
            return self._enter(token, _given(query, "card") or "")
        return self._file(path, headers) if path in PUBLIC else None

    def _for_session(self, headers: MultiMapping[str], path: str, query: str) -> web.Response | SignedIn:
        entry = self._sessions.cookie(_cookie(headers, self._site.cookie))
        if entry is None or (path == WEBSOCKET and not self._is_proved(entry, *_offered_proof(headers))):
            refused = _text(403, f"You are not signed in. {NEW_LINK} {self._site.link_command}")
            found = self._refused("You are not signed in.") if path in _PAGES else refused
            found.force_close()
            return found
        if path == WEBSOCKET:
            tab = _given(query, "tab") or ""
            return SignedIn(entry, least(entry.role, self._role), tab if tab.isalnum() else "")
        if path == "/session":
            nonce = self._new_nonce()
            made = proof(entry.key_sha256, f"console {_given(query, 'nonce')} {nonce}")
            return web.json_response({"nonce": nonce, "proof": made})
        return self._file(_PAGES.get(path, path), headers)

    def _new_nonce(self) -> str:
        now_s = time.monotonic()
        while self._nonces and (len(self._nonces) >= MAX_NONCES or now_s >= self._nonces[next(iter(self._nonces))]):
            del self._nonces[next(iter(self._nonces))]
        nonce = secrets.token_hex(16)
        self._nonces[nonce] = now_s + NONCE_S
        return nonce

    def _is_proved(self, entry: Entry, nonce: str, made: str) -> bool:
        """Whether the page knows the session's key; uses up the nonce."""
        is_valid = time.monotonic() < self._nonces.pop(nonce, 0.0) and bool(entry.key_sha256)
        return is_valid and hmac.compare_digest(proof(entry.key_sha256, f"page {nonce}"), made)

    def _enter(self, token: str, card: str) -> web.Response:
        found = self._sessions.exchange(token)
        if found is None:
            return self._refused("This link was used already, or is too old.")
        card = f"?{card}" if card.isascii() and card.isalpha() else ""
        response = web.Response(status=303, headers={"Location": f"{PUBLIC[0]}{card}#{found.key}"})
        secure = self._site.certificate is not None
        response.set_cookie(
            self._site.cookie, found.cookie, max_age=COOKIE_S, httponly=True, samesite="strict", secure=secure
        )
        return response

    def _refused(self, why: str) -> web.Response:
        """A page that explains how to sign in, on a phone and at the console's machine."""
        page = self._files["/refused.html"].content.decode()
        page = page.replace("WHY", escape(why)).replace("COMMAND", escape(self._site.link_command))
        return web.Response(status=403, text=page, content_type="text/html")

    def _file(self, path: str, headers: MultiMapping[str]) -> web.Response:
        file = self._files.get(path)
        if file is None:
            return _text(404, "there is nothing here")
        if _one(headers, "If-None-Match") == file.tag:
            return web.Response(status=304, headers={"ETag": file.tag})
        response = web.Response(body=file.content, headers={"ETag": file.tag, "Content-Type": file.kind})
        if "gzip" in (_one(headers, "Accept-Encoding") or "") and len(file.packed) < len(file.content):
            response.body = file.packed
            response.headers["Content-Encoding"] = "gzip"
        return response


def read_files() -> Mapping[str, PageFile]:
    """Return the page's files by path, 1 MB in memory: no request waits for a disk or takes a descriptor.

    A built package has them compressed; those of a repository are compressed here.
    """
    found = {}
    for path in PAGE.rglob("*"):
        if path.is_file() and path.suffix != PACKED:
            content, beside = path.read_bytes(), path.with_name(path.name + PACKED)
            packed = beside.read_bytes() if beside.exists() else gzip.compress(content, mtime=0)
            kind = mimetypes.guess_type(path.name)[0] or "text/plain"
            kind += "; charset=utf-8" if kind.startswith("text/") else ""
            tag = f'W/"{hashlib.sha256(content).hexdigest()[:32]}"'
            found[f"/{path.relative_to(PAGE).as_posix()}"] = PageFile(content, packed, kind, tag)
    return found


def _text(status: int, text: str) -> web.Response:
    return web.Response(status=status, text=f"{text}\n")


def _one(headers: MultiMapping[str], name: str) -> str | None:
    """The header's value; None if it is missing or repeated."""
    found = headers.getall(name, [])
    return found[0] if len(found) == 1 else None


def _given(query: str, name: str) -> str | None:
    """A parameter of an address, such as a link's token."""
    try:
        return parse_qs(query, keep_blank_values=True, max_num_fields=4).get(name, [None])[0]
    except ValueError:
        return None


def _cookie(headers: MultiMapping[str], name: str) -> str | None:
    given = (part.strip().partition("=") for header in headers.getall("Cookie", []) for part in header.split(";"))
    return next((value for found, _, value in given if found == name), None)


def proof(key_sha256: str, text: str) -> str:
    """Return an HMAC in hex that proves knowledge of the key with this SHA-256, as `key.js` makes it."""
    return hmac.new(key_sha256.encode(), text.encode("utf-8", "surrogatepass"), hashlib.sha256).hexdigest()


def _offered_proof(headers: MultiMapping[str]) -> tuple[str, str]:
    """The console's nonce and the page's proof; empty if none is offered."""
    for header in headers.getall("Sec-WebSocket-Protocol", []):
        for offered in map(str.strip, header.split(",")):
            if offered.startswith(PROOF_PREFIX) and offered.isascii():
                nonce, _, made = offered.removeprefix(PROOF_PREFIX).partition(".")
                return nonce, made
    return "", ""
