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

from aiohttp import web
from multidict import MultiMapping
from yarl import URL

from gateway.allowance import NS_PER_S
from gateway.nonces import Nonces
from gateway.people.console.server.sessions import Entry, Sessions
from gateway.people.console.server.site import Site

PAGE: Final = Path(__file__).parents[1] / "page"
WEBSOCKET: Final = "/ws"
NONCE_NS: Final = 10 * NS_PER_S
"""A page opens its WebSocket as soon as it receives the nonce."""
COOKIE_S: Final = 30 * 24 * 3600
"""Life of a browser's cookie, by the browser's wall clock, which a person may set. The session ends earlier."""
PACKED: Final = ".gz"
PUBLIC: Final = ("/enter.html", "/enter.js", "/key.js", "/refused.css")
"""The first three move the key of a new session from the address into the browser's storage."""
HEADERS: Final = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
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
NEW_LINK: Final = "A link that works once is printed, on the console's machine, by:"
_PAGES: Final = {"/": "/index.html", "/button": "/button.html"}


@dataclass(frozen=True)
class PageFile:
    """A file of the page, plain and by gzip, in memory: no request waits for a disk or takes a descriptor."""

    content: bytes
    packed: bytes
    kind: str
    tag: str

    def response(self, headers: MultiMapping[str]) -> web.Response:
        """Return the file, packed where that is smaller, or 304 to a browser that has it."""
        if headers.get("If-None-Match") == self.tag:
            return web.Response(status=304, headers={"ETag": self.tag})
        is_packed = "gzip" in headers.get("Accept-Encoding", "") and len(self.packed) < len(self.content)
        coding = {"Content-Encoding": "gzip"} if is_packed else {}
        named = {"ETag": self.tag, "Content-Type": self.kind, **coding}
        return web.Response(body=self.packed if is_packed else self.content, headers=named)


def read_files() -> Mapping[str, PageFile]:
    """Return the page's files by path. A built package has them packed; those of a repository are packed here."""
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


class Auth:
    """Answer requests with the page's files, and check sessions. For one thread."""

    def __init__(self, site: Site, sessions: Sessions) -> None:
        self._site = site
        self._sessions = sessions
        self._files = read_files()
        self._nonces = Nonces(NONCE_NS)

    def answer(self, url: URL, headers: MultiMapping[str]) -> web.Response | Entry:
        """Return the response, or the session whose WebSocket is admitted.

        A response to a request without a session closes its connection.
        """
        public = self._public(url, headers)
        if public is not None:
            public.force_close()
        found = self._for_session(url, headers) if public is None else public
        if isinstance(found, web.Response):
            found.headers.update(HEADERS)
        return found

    def _public(self, url: URL, headers: MultiMapping[str]) -> web.Response | None:
        """The answer to a request that no page of ours sends, and to one that needs no session."""
        host, origin = headers.get("Host"), headers.get("Origin")
        if not self._site.knows_host(host):
            return _text(403, f"this console is at {self._site.url}, and not at the address that you gave")
        if (url.path == WEBSOCKET or origin is not None) and not self._site.knows_origin(origin, host):
            return _text(403, "only the console's own page may come here")
        if url.path == "/" and "token" in url.query:
            return self._enter(*url.query["token"].partition(",")[::2])
        return self._files[url.path].response(headers) if url.path in PUBLIC else None

    def _for_session(self, url: URL, headers: MultiMapping[str]) -> web.Response | Entry:
        path, query = _PAGES.get(url.path, url.path), url.query
        entry = self._sessions.cookie(_cookie(headers, self._site.cookie))
        if entry is None or (path == WEBSOCKET and not self._is_proved(entry, query.get("nonce"), query.get("proof"))):
            why = "You are not signed in."
            found = (
                self._refused(why) if url.path in _PAGES else _text(403, f"{why} {NEW_LINK} {self._site.link_command}")
            )
            found.force_close()
            return found
        if path == WEBSOCKET:
            return entry
        if path == "/session":
            nonce = self._nonces.issue(secrets.token_hex(16), time.monotonic_ns())
            made = proof(entry.key_sha256, f"console {query.get('nonce')} {nonce}")
            return web.json_response({"nonce": nonce, "proof": made})
        return self._files[path].response(headers) if path in self._files else _text(404, "there is nothing here")

    def _is_proved(self, entry: Entry, nonce: str | None, made: str | None) -> bool:
        """Use up the nonce. Return whether the page knows the session's key."""
        if not nonce or not made or not self._nonces.spend(nonce, time.monotonic_ns()):
            return False
        return hmac.compare_digest(proof(entry.key_sha256, f"page {nonce}").encode(), made.encode())

    def _enter(self, token: str, card: str) -> web.Response:
        found = self._sessions.exchange(token)
        if found is None:
            return self._refused("This link was used already, or is too old.")
        card = f"?{card}" if card.isascii() and card.isalpha() else ""
        response = web.Response(status=303, headers={"Location": f"{PUBLIC[0]}{card}#{found.key}"})
        secure = self._site.tls is not None
        response.set_cookie(
            self._site.cookie, found.cookie, max_age=COOKIE_S, httponly=True, samesite="strict", secure=secure
        )
        return response

    def _refused(self, why: str) -> web.Response:
        """A page that explains how to sign in, on a phone and at the console's machine."""
        page = self._files["/refused.html"].content.decode()
        page = page.replace("WHY", escape(why)).replace("COMMAND", escape(self._site.link_command))
        return web.Response(status=403, text=page, content_type="text/html")


def proof(key_sha256: str, text: str) -> str:
    """Return an HMAC in hex that proves knowledge of the key with this SHA-256, as `key.js` makes it."""
    return hmac.new(key_sha256.encode(), text.encode("utf-8", "surrogatepass"), hashlib.sha256).hexdigest()


def _text(status: int, text: str) -> web.Response:
    return web.Response(status=status, text=f"{text}\n")


def _cookie(headers: MultiMapping[str], name: str) -> str | None:
    cookies = (part.strip().partition("=") for header in headers.getall("Cookie", []) for part in header.split(";"))
    return next((value for found, _, value in cookies if found == name), None)
