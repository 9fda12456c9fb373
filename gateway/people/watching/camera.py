"""Cameras: MJPEG over HTTP, fetched once for all pages, while a page shows it. Only the newest picture is kept.

A picture's age counts from its arrival. Added is the age that the server states: µStreamer's `X-UStreamer-Latency`
(seconds since it was taken; with `?extra_headers=1`), and its delay by `X-Timestamp` (the server's clock when it was
sent), compared with the quickest picture. A picture that is repeated byte for byte keeps its age: µStreamer repeats the
last one while its camera is stuck.
"""

import asyncio
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from email.message import Message
from typing import Final, NamedTuple

import aiohttp
from yarl import URL

from gateway.errors import ConfigError
from gateway.rate_limit import NS_PER_S, RateLimit

MAX_CAMERAS: Final = 4
MAX_JPEG_BYTES: Final = 1_000_000
"""A picture of 1920 x 1080 has 0.2 to 0.6 MB."""
MAX_HEAD_BYTES: Final = 4096
"""The headers of a picture; µStreamer's have 600."""
BYTES_A_SECOND: Final = 8_000_000
"""Read of one camera: 64 Mbit/s, a few percent of a processor. A server that sends more has to wait."""
SILENT_S: Final = 5.0
"""The longest wait for a picture, also for the first."""
AGAIN_S: Final = 1.0
"""Pause before a camera is tried again."""
MAX_REDIRECTS: Final = 3
DRIFT: Final = 200e-6
"""Twice the error of a bad crystal, since two clocks drift apart."""
MAX_LATE_NS: Final = 5 * NS_PER_S
"""A picture that is later by its server's clock than this: that clock was set. A new connection begins anew."""
UNNAMED: Final = "camera"

_NAMED: Final = re.compile(r"(?P<name>[A-Za-z0-9_-]{1,20})=(?P<url>https?://.*)", re.DOTALL)


class CameraError(Exception):
    """The camera sends no picture that can be used; the text ends the sentence "The camera …"."""


class Picture(NamedTuple):
    """A JPEG, and when it was taken (the console's monotonic clock), as far as is known."""

    jpeg: bytes
    taken_ns: int


class StreamPart(NamedTuple):
    """A part of a multipart stream; its headers in lower case."""

    headers: Mapping[str, str]
    jpeg: bytes


class Mjpeg:
    """Cuts a multipart stream into JPEGs, and keeps `MAX_JPEG_BYTES` at most. Pure."""

    def __init__(self, boundary: str) -> None:
        """Some servers have the dashes in the boundary already, so these do not count."""
        self._delimiter = b"--" + boundary.strip("-").encode("latin-1", "replace")
        self._bytes = bytearray()
        self._headers: dict[str, str] | None = None

    def feed(self, data: bytes) -> Iterator[StreamPart]:
        """Yield the parts that are complete. Raises CameraError for anything that is no stream of JPEGs."""
        self._bytes += data
        while (self._headers is not None or self._head()) and (jpeg := self._body()) is not None:
            yield StreamPart(self._headers or {}, jpeg)
            self._headers = None

    def _head(self) -> bool:
        begin = self._bytes.find(self._delimiter)
        end = self._bytes.find(b"\r\n\r\n", max(begin, 0))
        if begin < 0 or end < 0:
            if len(self._bytes) > MAX_HEAD_BYTES:
                raise CameraError("sends no picture that begins")
            return False
        lines = self._bytes[begin:end].decode("latin-1").split("\r\n")[1:]
        fields = (line.partition(":") for line in lines)
        self._headers = {name.strip().lower(): value.strip() for name, _, value in fields}
        del self._bytes[: end + 4]
        if self._headers.get("content-type", "").partition(";")[0].lower() not in ("image/jpeg", "image/jpg"):
            raise CameraError("sends something other than JPEGs")
        return True

    def _body(self) -> bytes | None:
        stated = (self._headers or {}).get("content-length", "")
        size = int(stated) if stated.isascii() and stated.isdigit() else -1
        if size < 0:
            size = self._bytes.find(b"\r\n" + self._delimiter)
        if max(size, len(self._bytes) if size < 0 else 0) > MAX_JPEG_BYTES:
            raise CameraError("sends pictures of more than 1 MB; set a lower resolution or quality")
        if size < 0 or len(self._bytes) < size:
            return None
        jpeg = bytes(self._bytes[:size])
        del self._bytes[:size]
        if not jpeg.startswith(b"\xff\xd8"):
            raise CameraError("sends something other than JPEGs")
        return jpeg


class Ages:
    """When pictures of one connection were taken, by what their server states. Pure."""

    def __init__(self) -> None:
        self._least_ns: float | None = None
        """The least difference of arrival and `X-Timestamp`: a way without delay."""
        self._before_ns = 0

    def taken_ns(self, headers: Mapping[str, str], now_ns: int) -> int:
        """Raises CameraError if the picture is too old, or its server's clock was set."""
        late_ns = _seconds(headers, "x-ustreamer-latency") * NS_PER_S
        if sent_s := _seconds(headers, "x-timestamp"):
            apart_ns = now_ns - sent_s * NS_PER_S
            drifted_ns = apart_ns if self._least_ns is None else self._least_ns + DRIFT * (now_ns - self._before_ns)
            self._least_ns, self._before_ns = min(apart_ns, drifted_ns), now_ns
            late_ns += apart_ns - self._least_ns
        if late_ns > MAX_LATE_NS:
            raise CameraError("sends old pictures, or its clock was set")
        return now_ns - round(late_ns)


def _seconds(headers: Mapping[str, str], name: str) -> float:
    """A header's value; 0 if there is none."""
    with suppress(ValueError):
        return max(0.0, min(float(headers.get(name, "")), 1e10))
    return 0.0


class Camera:
    """One camera. On the event loop."""

    def __init__(self, name: str, url: URL) -> None:
        self.name = name
        self._url = url
        self._viewers = 0
        self._fetching: asyncio.Task[None] | None = None
        self._newest: Picture | None = None
        self._changed = asyncio.Condition()
        self.trouble = ""
        """Why no picture comes, in one sentence; "" while pictures come."""

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Fetch its pictures within the block."""
        self._viewers += 1
        if self._fetching is None:
            self._fetching = asyncio.get_running_loop().create_task(self._run())
        try:
            yield
        finally:
            self._viewers -= 1
            if not self._viewers:
                self._fetching.cancel()
                self._fetching = self._newest = None

    async def newer(self, than: Picture | None, timeout_s: float) -> Picture | None:
        """Wait for a newer picture. Return None if none comes in time."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s), self._changed:
                await self._changed.wait_for(lambda: self._newest is not None and self._newest is not than)
                return self._newest
        return None

    async def _run(self) -> None:
        # No cookies, no proxies of the environment, nothing that unpacks itself to any size.
        async with aiohttp.ClientSession(
            cookie_jar=aiohttp.DummyCookieJar(), auto_decompress=False, timeout=aiohttp.ClientTimeout(total=None)
        ) as session:
            while True:
                try:
                    await self._fetch(session)
                except CameraError as error:
                    self._explain(str(error))
                except TimeoutError:
                    self._explain(f"has sent no picture for {SILENT_S:g} s")
                except (aiohttp.ClientError, OSError, ValueError):
                    self._explain("cannot be reached, or its stream broke off")
                await asyncio.sleep(AGAIN_S)

    def _explain(self, why: str) -> None:
        self.trouble = f"The camera {self.name} {why}."

    async def _fetch(self, session: aiohttp.ClientSession) -> None:
        """Raises CameraError, TimeoutError, aiohttp.ClientError, OSError, ValueError, also if the stream has ended."""
        url = self._url
        async with asyncio.timeout(SILENT_S) as silence:
            for _ in range(1 + MAX_REDIRECTS):
                async with session.get(url, allow_redirects=False) as answer:
                    if (to := answer.headers.get("Location")) is None or answer.status // 100 != 3:
                        await self._read(answer, silence)
                    elif (url := url.join(URL(to))).host != self._url.host:
                        raise CameraError("redirects to another host; name that one")
            raise CameraError("redirects again and again")

    async def _read(self, answer: aiohttp.ClientResponse, silence: asyncio.Timeout) -> None:
        kind = Message()
        kind["content-type"] = answer.headers.get("Content-Type", "")
        boundary = kind.get_boundary()
        if answer.status != 200:
            raise CameraError(f"answers with HTTP status {answer.status}")
        if kind.get_content_maintype() != "multipart" or not boundary:
            raise CameraError("sends no MJPEG stream; name the stream's address, such as http://…:8080/stream")
        parts, ages, allowance = Mjpeg(boundary), Ages(), RateLimit(BYTES_A_SECOND, BYTES_A_SECOND)
        async for data in answer.content.iter_any():
            for part in parts.feed(data):
                silence.reschedule(asyncio.get_running_loop().time() + SILENT_S)
                await self._take(part, ages.taken_ns(part.headers, time.monotonic_ns()))
            if not allowance.take(time.monotonic_ns(), len(data)):
                await asyncio.sleep(len(data) / BYTES_A_SECOND)
        raise CameraError("has ended its stream")

    async def _take(self, part: StreamPart, taken_ns: int) -> None:
        if part.headers.get("x-ustreamer-online", "true") != "true":
            raise CameraError("is not connected to its server")
        if self._newest is not None and self._newest.jpeg == part.jpeg:
            return
        self._newest, self.trouble = Picture(part.jpeg, taken_ns), ""
        async with self._changed:
            self._changed.notify_all()


def cameras(named: Sequence[str]) -> dict[str, Camera]:
    """Return the cameras of `URL` and `NAME=URL`, by name. Raises ConfigError."""
    found = dict[str, Camera]()
    for each in named:
        match = _NAMED.fullmatch(each)
        name, text = (match["name"], match["url"]) if match else (UNNAMED, each)
        with suppress(ValueError):
            url = URL(text)
            if url.scheme in ("http", "https") and url.host and text.isprintable() and name not in found:
                found[name] = Camera(name, url)
                continue
        raise ConfigError(
            f"--camera {name}: two cameras need two names, such as --camera front=http://…"
            if name in found
            else "--camera is no URL of an MJPEG stream, such as http://127.0.0.1:8081/stream?extra_headers=1"
        )
    if len(found) > MAX_CAMERAS:
        raise ConfigError(f"--camera: {MAX_CAMERAS} cameras at most")
    return found
