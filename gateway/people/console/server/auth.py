"""Answers HTTP requests from memory; without a session by 403 and a reason, and the connection is closed.

A session has two secrets. Browsers send the cookie with every request, also to other ports of the same host, where
another user of the machine may listen. So it gives access to the page's files alone; the WebSocket also requires the
session's key, which the page keeps for its own origin (scheme, host and port), and pictures a secret of the WebSocket.

The key is never sent, since another program may listen at this origin while the console is started again. The page
sends a nonce to `/session`; the answer has the console's nonce, and an HMAC over both proves that it knows the key.
Only then the page opens its WebSocket, with an HMAC over the console's nonce.
"""

import asyncio
import gzip
import hashlib
import hmac
import mimetypes
import secrets
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from html import escape
from pathlib import Path
from typing import Final

from aiohttp import web
from multidict import MultiMapping
from yarl import URL

from gateway.certs.proof import Nonces
from gateway.people.console.server.sessions import Entry, Sessions
from gateway.people.console.server.site import Site
from gateway.rate_limit import NS_PER_S

PAGE: Final = Path(__file__).parents[1] / "page"
WEBSOCKET: Final = "/ws"
CAMERA: Final = "/camera/"
NONCE_NS: Final = 10 * NS_PER_S
"""A page opens its WebSocket as soon as it receives the nonce."""
COOKIE_S: Final = 30 * 24 * 3600
"""Life of a browser's cookie, by the browser's wall clock, which a person may set. The session ends earlier."""
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
_PAGES: Final = {"/": "/index.html", "/button": "/button.html"}


class PageFile:
    """A file of the page, plain and by gzip, in memory: no request waits for a disk or takes a descriptor."""

    def __init__(self, path: Path) -> None:
        self.content: Final = path.read_bytes()
        built = path.with_name(f"{path.name}.gz")  # only in a package; from a repository all take 30 ms
        self._packed = built.read_bytes() if built.exists() else gzip.compress(self.content, 5)
        kind = mimetypes.guess_type(path.name)[0] or "text/plain"
        kind += "; charset=utf-8" if kind.startswith("text/") else ""
        self._headers = {"ETag": f'W/"{hashlib.sha256(self.content).hexdigest()[:32]}"', "Content-Type": kind}

    def response(self, headers: MultiMapping[str]) -> web.Response:
        """Return the file, packed to a browser that accepts this, or 304 to a browser that has it."""
        if headers.get("If-None-Match") == self._headers["ETag"]:
            return web.Response(status=304, headers=self._headers)
        if "gzip" in headers.get("Accept-Encoding", ""):
            return web.Response(body=self._packed, headers={**self._headers, "Content-Encoding": "gzip"})
        return web.Response(body=self.content, headers=self._headers)


@cache
def read_files() -> Mapping[str, PageFile]:
    """Return the page's files by path; not their packed copies (`.gz`)."""
    return {f"/{path.relative_to(PAGE).as_posix()}": PageFile(path) for path in PAGE.rglob("*.*[!z]")}


class Auth:
    """Answer requests with the page's files, and check sessions. For one thread."""

    def __init__(self, site: Site, sessions: Sessions) -> None:
        self._site = site
        self._sessions = sessions
        self._files = read_files()
        self._nonces = Nonces(NONCE_NS)
        self._writer = ThreadPoolExecutor(1, "sign-in")
        """Waits for the disk, and for other processes that write the sessions."""

    async def answer(self, url: URL, headers: MultiMapping[str]) -> web.Response | Entry:
        """Return the response, or the session whose WebSocket or request for a picture is admitted."""
        found = await self._admit(url, headers)
        if isinstance(found, web.Response):
            found.force_close()
        elif url.path == WEBSOCKET or url.path.startswith(CAMERA):
            return found
        elif url.path == "/session":
            nonce = self._nonces.issue(secrets.token_hex(16), time.monotonic_ns())
            made = proof(found.key_sha256, f"console {url.query.get('nonce')} {nonce}")
            found = web.json_response({"nonce": nonce, "proof": made})
        elif (file := self._files.get(_PAGES.get(url.path, url.path))) is not None:
            found = file.response(headers)
        else:
            found = web.Response(status=404, text="there is nothing here")
        found.headers.update(HEADERS)
        return found

    async def _admit(self, url: URL, headers: MultiMapping[str]) -> web.Response | Entry:
        """The session of the request, for a WebSocket with a proof of its key; else the response."""
        host, origin = headers.get("Host"), headers.get("Origin")
        if not self._site.knows_host(host):
            return web.Response(
                status=403, text="this console is not known by that name; console --host NAME admits it"
            )
        if (url.path == WEBSOCKET or origin is not None) and not self._site.is_own(origin, host):
            return web.Response(status=403, text="only the console's own page may come here")
        if url.path == "/" and "token" in url.query:
            return await self._exchange(self._site.cookie_at(host), *url.query["token"].partition(",")[::2])
        if url.path in PUBLIC:
            return self._files[url.path].response(headers)
        entry = self._sessions.cookie(_cookie(headers, self._site.cookie_at(host)))
        if entry is not None and (url.path != WEBSOCKET or self._is_proved(entry, url.query)):
            return entry
        return self._refused("You are not signed in.")

    def _is_proved(self, entry: Entry, query: MultiMapping[str]) -> bool:
        """Use up the nonce. Return whether the page knows the session's key."""
        nonce, made = query.get("nonce", ""), query.get("proof", "")
        wanted = proof(entry.key_sha256, f"page {nonce}")
        return self._nonces.spend(nonce, time.monotonic_ns()) and hmac.compare_digest(wanted.encode(), made.encode())

    async def _exchange(self, name: str, token: str, card: str) -> web.Response:
        found = await asyncio.get_running_loop().run_in_executor(self._writer, self._sessions.exchange, token)
        if found is None:
            return self._refused("This link was used already, or is too old.")
        cookie, key = found
        card = f"?{card}" if card.isascii() and card.isalpha() else ""
        response = web.Response(status=303, headers={"Location": f"{PUBLIC[0]}{card}#{key}"})
        secure = self._site.tls is not None
        response.set_cookie(name, cookie, max_age=COOKIE_S, httponly=True, samesite="strict", secure=secure)
        return response

    def _refused(self, why: str) -> web.Response:
        """A page that explains how to sign in, on a phone and at the console's machine."""
        page = self._files["/refused.html"].content.decode()
        page = page.replace("WHY", escape(why)).replace("COMMAND", escape(self._site.link_command))
        return web.Response(status=403, text=page, content_type="text/html")


def proof(key_sha256: str, text: str) -> str:
    """Return an HMAC in hex that proves knowledge of the key with this SHA-256, as `key.js` makes it."""
    return hmac.new(key_sha256.encode(), text.encode("utf-8", "surrogatepass"), hashlib.sha256).hexdigest()


def _cookie(headers: MultiMapping[str], name: str) -> str:
    cookies = (part.strip().partition("=") for header in headers.getall("Cookie", []) for part in header.split(";"))
    return next((value for found, _, value in cookies if found == name), "")
