"""Answers HTTP requests, without I/O. A request without a session is answered by 403, a reason, and nothing else.

A session has two secrets. Browsers send the cookie with every request, also to other ports of the same host, where
another user of the machine may listen. So it gives access to the page's files alone; the WebSocket also requires the
session's key, which the page keeps for its own origin (scheme, host and port).

The key is never sent, since another program may listen at this origin while the console is started again. The page
sends a nonce to `/session`; the answer has the console's nonce, and an HMAC over both proves that it knows the key.
Only then the page opens its WebSocket, with an HMAC over the console's nonce.
"""

import hashlib
import hmac
import json
import mimetypes
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass
from email.utils import formatdate
from html import escape
from http import HTTPStatus
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs

from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

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
}


@dataclass(frozen=True)
class SignedIn:
    """A WebSocket request of a page with a session."""

    entry: Entry
    role: Role
    tab: str = ""
    """The browser's tab, by a name that it gave itself: the same after a reload. Empty: it told none."""


_PAGES: Final = {"/": "/index.html", "/button": "/button.html"}


@dataclass(frozen=True)
class HttpAnswer:
    """`is_for_session`: the request had a valid session."""

    response: Response
    is_for_session: bool = False


@dataclass(frozen=True)
class _PageFile:
    content: bytes
    kind: str
    tag: str


class Auth:
    """Knows the page's files and the site; its sessions are in a file. For one thread."""

    def __init__(self, site: Site, sessions: Sessions, role: Role) -> None:
        """`role`: what a page may do at most."""
        self._site = site
        self._sessions = sessions
        self._role = role
        self._files = _files()
        self._nonces: dict[str, float] = {}
        """Issued and not used, and until when each is valid, monotonic."""

    def answer(self, request: Request) -> HttpAnswer | SignedIn:
        """The response, or the session whose WebSocket is admitted."""
        found = self._answer(request)
        if isinstance(found, HttpAnswer):
            self._add_headers(request, found.response)
        return found

    def _answer(self, request: Request) -> HttpAnswer | SignedIn:
        path, _, query = request.path.partition("?")
        if (why := self._why_not(request, path)) is not None:
            return why
        if path == "/" and (token := _given(query, "token")) is not None:
            return self._enter(token, _given(query, "card") or "")
        if path in PUBLIC:
            return self._file(path, request)
        return self._for_session(request, path, query)

    def _why_not(self, request: Request, path: str) -> HttpAnswer | None:
        """The answer to a request that no page of ours sends."""
        host, origin = _one(request, "Host"), _one(request, "Origin")
        if request.method != "GET":
            return _text(HTTPStatus.METHOD_NOT_ALLOWED, "only GET")
        if not self._site.knows_host(host):
            return _no(f"this console is at {self._site.url}, and not at the address that you gave")
        if (path == WEBSOCKET or "Origin" in request.headers) and not self._site.knows_origin(origin, host):
            return _no("only the console's own page may come here")
        return None

    def _for_session(self, request: Request, path: str, query: str) -> HttpAnswer | SignedIn:
        entry = self._sessions.cookie(_cookie(request, self._site.cookie))
        if entry is None or (path == WEBSOCKET and not self._is_proved(entry, *_offered_proof(request))):
            if path in _PAGES:
                return self._refused("You are not signed in.")
            return _no(f"You are not signed in. {NEW_LINK} {self._site.link_command}")
        role = least(entry.role, self._role)
        if path == WEBSOCKET:
            return SignedIn(entry, role, tab if (tab := _given(query, "tab") or "").isalnum() else "")
        if path == "/session":
            nonce = self._new_nonce()
            answer = {"nonce": nonce, "proof": proof(entry.key_sha256, f"console {_given(query, 'nonce')} {nonce}")}
            return HttpAnswer(_response(HTTPStatus.OK, json.dumps(answer).encode(), "json"))
        return self._file(_PAGES.get(path, path), request)

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

    def _enter(self, token: str, card: str) -> HttpAnswer:
        found = self._sessions.exchange(token)
        if found is None:
            return self._refused("This link was used already, or is too old.")
        card = f"?{card}" if card.isascii() and card.isalpha() else ""
        secure = "; Secure" if self._site.certificate is not None else ""
        cookie = f"{self._site.cookie}={found.cookie}; HttpOnly; Max-Age={COOKIE_S}; Path=/; SameSite=strict{secure}"
        response = _response(HTTPStatus.SEE_OTHER, b"", "plain")
        response.headers["Location"] = f"{PUBLIC[0]}{card}#{found.key}"
        response.headers["Set-Cookie"] = cookie
        return HttpAnswer(response)

    def _refused(self, why: str) -> HttpAnswer:
        """A page that explains how to sign in, on a phone and at the console's machine."""
        page = self._files["/refused.html"].content.decode()
        page = page.replace("WHY", escape(why)).replace("COMMAND", escape(self._site.link_command))
        return HttpAnswer(_response(HTTPStatus.FORBIDDEN, page.encode(), "html"))

    def _file(self, path: str, request: Request) -> HttpAnswer:
        file = self._files.get(path)
        for_session = path not in PUBLIC
        if file is None:
            return _text(HTTPStatus.NOT_FOUND, "there is nothing here")
        if _one(request, "If-None-Match") == file.tag:
            response = _response(HTTPStatus.NOT_MODIFIED, b"", file.kind)
        else:
            response = _response(HTTPStatus.OK, file.content, file.kind)
        response.headers["ETag"] = file.tag
        return HttpAnswer(response, is_for_session=for_session)

    def _add_headers(self, request: Request, response: Response) -> None:
        host = _one(request, "Host") or ""
        socket = f"{'wss' if self._site.certificate else 'ws'}://{host}" if self._site.knows_host(host) else ""
        for name, value in HEADERS.items():
            response.headers[name] = value
        response.headers["content-security-policy"] = CONTENT_POLICY.format(socket=socket)


def _files() -> Mapping[str, _PageFile]:
    """The page's files, 2 MB in memory: no request waits for a disk or takes a descriptor."""
    found = {}
    for path in PAGE.rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            kind = mimetypes.guess_type(path.name)[0] or "text/plain"
            tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
            found[f"/{path.relative_to(PAGE).as_posix()}"] = _PageFile(content, kind, tag)
    return found


def _no(why: str) -> HttpAnswer:
    return _text(HTTPStatus.FORBIDDEN, why)


def _text(status: HTTPStatus, text: str) -> HttpAnswer:
    return HttpAnswer(_response(status, f"{text}\n".encode(), "plain"))


def _response(status: HTTPStatus, body: bytes, kind: str) -> Response:
    """Closes its connection: each serves one request, and what follows it is not read."""
    kinds = {"html": "text/html; charset=utf-8", "plain": "text/plain; charset=utf-8", "json": "application/json"}
    headers = Headers(Date=formatdate(usegmt=True), Connection="close")
    if status is not HTTPStatus.NOT_MODIFIED:
        headers["Content-Length"] = str(len(body))
        headers["Content-Type"] = kinds.get(kind, kind)
    return Response(status.value, status.phrase, headers, body)


def _one(request: Request, name: str) -> str | None:
    """The header's value; None if it is missing or repeated."""
    try:
        return request.headers.get(name)
    except MultipleValuesError:
        return None


def _given(query: str, name: str) -> str | None:
    """A parameter of an address, such as a link's token."""
    try:
        return parse_qs(query, keep_blank_values=True, max_num_fields=4).get(name, [None])[0]
    except ValueError:
        return None


def _cookie(request: Request, name: str) -> str | None:
    for header in request.headers.get_all("Cookie"):
        for part in header.split(";"):
            found, _, value = part.strip().partition("=")
            if found == name:
                return value
    return None


def proof(key_sha256: str, text: str) -> str:
    """Proves knowledge of the key that has this SHA-256: an HMAC in hex, as `key.js` makes it."""
    return hmac.new(key_sha256.encode(), text.encode("utf-8", "surrogatepass"), hashlib.sha256).hexdigest()


def _offered_proof(request: Request) -> tuple[str, str]:
    """The console's nonce and the page's proof; empty if none is offered."""
    for header in request.headers.get_all("Sec-WebSocket-Protocol"):
        for offered in header.split(","):
            if offered.strip().startswith(PROOF_PREFIX) and offered.isascii():
                nonce, _, made = offered.strip().removeprefix(PROOF_PREFIX).partition(".")
                return nonce, made
    return "", ""
