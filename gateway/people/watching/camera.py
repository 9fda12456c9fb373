"""Cameras: MJPEG over HTTP, fetched once for all pages, while a page shows it. Only the newest picture is kept.

A picture's age counts from its arrival. Added is the age that the server states: µStreamer's `X-UStreamer-Latency`
(seconds since it was taken; with `?extra_headers=1`), and its delay by `X-Timestamp` (the server's clock when it was
sent), compared with the quickest picture. A picture that is repeated byte for byte keeps its age: µStreamer repeats the
last one while its camera is stuck.
"""

import asyncio
import re
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from email.message import Message
from email.parser import HeaderParser
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
DRIFT: Final = 200e-6
"""Twice the error of a bad crystal, since two clocks drift apart."""
MAX_LATE_NS: Final = 5 * NS_PER_S
"""A picture that is later by its server's clock than this: that clock was set. A new connection begins anew."""
UNNAMED: Final = "camera"
_TOO_LARGE: Final = "sends pictures of more than 1 MB; set a lower resolution or quality"

_NAMED: Final = re.compile(r"(?P<name>[A-Za-z0-9_-]{1,20})=(?P<url>https?://.*)", re.DOTALL)


class CameraError(Exception):
    """The camera sends no picture that can be used; the text ends the sentence "The camera …"."""


class Picture(NamedTuple):
    """A JPEG, and when it was taken (the console's monotonic clock), as far as is known."""

    jpeg: bytes
    taken_ns: int


class StreamParts:
    """The parts of a multipart stream, one after the other. At most a picture is in memory."""

    def __init__(self, more: Callable[[], Awaitable[bytes]], boundary: str) -> None:
        """`more` returns the stream's next bytes. Some servers have the dashes in the boundary already."""
        self._more = more
        self._delimiter = b"--" + boundary.strip("-").encode("latin-1", "replace")
        self._bytes = bytearray()

    async def next(self) -> tuple[Message, bytes]:
        """Return a part's headers and its JPEG. Raises CameraError for anything else, and what `more` raises."""
        await self._take(self._delimiter, MAX_HEAD_BYTES, "sends no picture that begins")
        head = await self._take(b"\r\n\r\n", MAX_HEAD_BYTES, "sends no picture that begins")
        headers = HeaderParser().parsestr(head.partition(b"\r\n")[2].decode("latin-1"))
        stated = headers.get("content-length", "")
        end = 4 + int(stated) if stated.isascii() and stated.isdigit() else b"\r\n" + self._delimiter
        if headers.get_content_type() in ("image/jpeg", "image/jpg"):
            jpeg = (await self._take(end, MAX_JPEG_BYTES, _TOO_LARGE))[4:]
            if jpeg.startswith(b"\xff\xd8"):
                return headers, jpeg
        raise CameraError("sends something other than JPEGs")

    async def _take(self, end: bytes | int, most: int, why: str) -> bytes:
        """Take the bytes before the mark `end`, or `end` bytes. Raise CameraError with `why` for more than `most`."""
        while True:
            at = self._bytes.find(end) if isinstance(end, bytes) else end
            if (at if at >= 0 else len(self._bytes)) > most:
                raise CameraError(why)
            if 0 <= at <= len(self._bytes):
                break
            self._bytes += await self._more()
        found = bytes(self._bytes[:at])
        del self._bytes[:at]
        return found


class Ages:
    """When pictures of one connection were taken, by what their server states. Pure."""

    def __init__(self) -> None:
        self._least_ns: float | None = None
        """The least difference of arrival and `X-Timestamp`: a way without delay."""
        self._before_ns = 0

    def taken_ns(self, headers: Message | Mapping[str, str], now_ns: int) -> int:
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


def _seconds(headers: Message | Mapping[str, str], name: str) -> float:
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
        """Raises CameraError, also if the stream has ended, TimeoutError, aiohttp.ClientError, OSError, ValueError."""
        async with asyncio.timeout(SILENT_S) as silence, session.get(self._url, allow_redirects=False) as answer:
            await self._read(answer, silence)

    async def _read(self, answer: aiohttp.ClientResponse, silence: asyncio.Timeout) -> None:
        if answer.status // 100 == 3:
            raise CameraError("redirects to another address; name that one")
        if answer.status != 200:
            raise CameraError(f"answers with HTTP status {answer.status}")
        kind = HeaderParser().parsestr(f"content-type: {answer.headers.get('content-type', '')}")
        boundary = kind.get_boundary()
        if kind.get_content_maintype() != "multipart" or not boundary:
            raise CameraError("sends no MJPEG stream; name the stream's address, such as http://…:8080/stream")
        ages, allowance = Ages(), RateLimit(BYTES_A_SECOND, BYTES_A_SECOND)

        async def more() -> bytes:
            if not (data := await answer.content.readany()):
                raise CameraError("has ended its stream")
            if not allowance.take(time.monotonic_ns(), len(data)):
                await asyncio.sleep(len(data) / BYTES_A_SECOND)
            return data

        parts = StreamParts(more, boundary)
        while True:
            headers, jpeg = await parts.next()
            silence.reschedule(asyncio.get_running_loop().time() + SILENT_S)
            await self._take(headers, jpeg, ages.taken_ns(headers, time.monotonic_ns()))

    async def _take(self, headers: Message, jpeg: bytes, taken_ns: int) -> None:
        if headers.get("x-ustreamer-online", "true") != "true":
            raise CameraError("is not connected to its server")
        if self._newest is not None and self._newest.jpeg == jpeg:
            return
        self._newest, self.trouble = Picture(jpeg, taken_ns), ""
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
