"""Cameras: MJPEG over HTTP, fetched once for all pages, while somebody asks for it. Only the newest picture is kept.

A picture's age counts from its arrival. Added is the age that the server states: µStreamer's `X-UStreamer-Latency`
(seconds since it was taken; with `?extra_headers=1`), and its delay by `X-Timestamp` (the server's clock when it was
sent), compared with the quickest picture. A picture that is repeated byte for byte keeps its age: µStreamer repeats the
last one while its camera is stuck.
"""

import asyncio
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from email.message import Message
from email.parser import HeaderParser
from typing import Final, NamedTuple

import aiohttp

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
"""The longest wait for a picture, also for the first; and how long a camera is fetched after the last question."""
AGAIN_S: Final = 1.0
"""Pause before a camera is tried again."""
DRIFT: Final = 200e-6
"""Twice the error of a bad crystal, since two clocks drift apart."""
MAX_LATE_NS: Final = 5 * NS_PER_S
"""A picture that is later by its server's clock than this: that clock was set. A new connection begins anew."""

_URL: Final = r"https?://(?:[^\s/?#@]*@)?(?:\[[\da-fA-F:.]+]|[\w.-]+)(?::\d{1,5})?(?:[/?#]\S*)?"
_NAMED: Final = re.compile(rf"(?:(?P<name>[A-Za-z0-9_-]{{1,20}})=)?(?P<url>{_URL})")


class CameraError(Exception):
    """The camera sends no picture that can be used; the text ends the sentence "The camera …"."""


class Picture(NamedTuple):
    """A JPEG, and when it was taken (the console's monotonic clock), as far as is known."""

    jpeg: bytes
    taken_ns: int


async def stream_parts(more: Callable[[], Awaitable[bytes]], boundary: str) -> AsyncIterator[tuple[Message, bytes]]:
    """Yield the headers and the JPEG of each part of a stream, whose next bytes `more` returns. Raises CameraError."""
    delimiter = b"--" + boundary.strip("-").encode("latin-1", "replace")  # some servers' boundary has the dashes
    unread, allowance = bytearray(), RateLimit(BYTES_A_SECOND, BYTES_A_SECOND)

    async def take(end: bytes | int, most: int, why: str) -> bytes:
        """Return the bytes before the mark `end`, or `end` bytes. Raise CameraError with `why` for more than `most`."""
        while True:
            at = unread.find(end) if isinstance(end, bytes) else end
            if (at if at >= 0 else len(unread)) > most:
                raise CameraError(why)
            if 0 <= at <= len(unread):
                found = bytes(unread[:at])
                del unread[:at]
                return found
            if not (data := await more()):
                raise CameraError("has ended its stream")
            unread.extend(data)

    while True:
        await take(delimiter, MAX_HEAD_BYTES, "sends no picture that begins")
        head = await take(b"\r\n\r\n", MAX_HEAD_BYTES, "sends no picture that begins")
        headers = HeaderParser().parsestr(head.partition(b"\r\n")[2].decode("latin-1"))
        stated = headers.get("content-length", "")
        end = 4 + int(stated) if stated.isascii() and stated.isdigit() else b"\r\n" + delimiter
        body = await take(end, MAX_JPEG_BYTES, "sends pictures of more than 1 MB; set a lower resolution or quality")
        if not (jpeg := body[4:]).startswith(b"\xff\xd8"):
            raise CameraError("sends something other than JPEGs")
        yield headers, jpeg
        while not allowance.take(time.monotonic_ns(), MAX_HEAD_BYTES + len(jpeg)):  # noqa: ASYNC110
            await asyncio.sleep(len(jpeg) / BYTES_A_SECOND)


class Ages:
    """When pictures of one connection were taken, by what their server states. Pure."""

    def __init__(self) -> None:
        self._least_ns = float("inf")
        """The least difference of arrival and `X-Timestamp`: a way without delay."""
        self._before_ns = 0

    def taken_ns(self, headers: Message | Mapping[str, str], now_ns: int) -> int:
        """Raises CameraError if the picture is too old, or its server's clock was set."""
        late_ns = _seconds(headers, "x-ustreamer-latency") * NS_PER_S
        if sent_s := _seconds(headers, "x-timestamp"):
            apart_ns = now_ns - sent_s * NS_PER_S
            drifted_ns = self._least_ns + DRIFT * (now_ns - self._before_ns)
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

    def __init__(self, name: str, url: str) -> None:
        self.name = name
        self._url = url
        self._fetched_until_s = 0.0
        self._fetching: asyncio.Task[None] | None = None
        self._newest: Picture | None = None
        self._changed = asyncio.Condition()
        self.trouble = ""
        """Why no picture comes, in one sentence; "" while pictures come."""

    async def newer(self, than: Picture | None, timeout_s: float) -> Picture | None:
        """Wait for a newer picture. Return None if none comes in time."""
        self._fetched_until_s = time.monotonic() + timeout_s + SILENT_S
        if self._fetching is None or self._fetching.done():
            self._fetching = asyncio.create_task(self._run())
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s), self._changed:
                await self._changed.wait_for(lambda: self._newest is not None and self._newest is not than)
                return self._newest
        return None

    async def _run(self) -> None:
        while time.monotonic() < self._fetched_until_s:
            try:
                await self._fetch()
                continue
            except CameraError as error:
                why = str(error)
            except TimeoutError:
                why = f"has sent no picture for {SILENT_S:g} s"
            except (aiohttp.ClientError, OSError, ValueError):
                why = "cannot be reached, or its stream broke off"
            self.trouble = f"The camera {self.name} {why}."
            await asyncio.sleep(AGAIN_S)
        self._newest = None

    async def _fetch(self) -> None:
        async with (
            asyncio.timeout(SILENT_S) as silence,
            aiohttp.ClientSession(auto_decompress=False, timeout=aiohttp.ClientTimeout()) as session,
            session.get(self._url, allow_redirects=False) as answer,
        ):
            if answer.status // 100 == 3:
                raise CameraError("redirects to another address; name that one")
            if answer.status != 200:
                raise CameraError(f"answers with HTTP status {answer.status}")
            kind = f"content-type: {answer.headers.get('content-type', '')}"
            if not (boundary := HeaderParser().parsestr(kind).get_boundary()):
                raise CameraError("sends no MJPEG stream; name the stream's address, such as http://…:8080/stream")
            ages = Ages()
            async for headers, jpeg in stream_parts(answer.content.readany, boundary):
                silence.reschedule(asyncio.get_running_loop().time() + SILENT_S)
                if headers.get("x-ustreamer-online", "true") != "true":
                    raise CameraError("is not connected to its server")
                taken_ns = ages.taken_ns(headers, time.monotonic_ns())
                if self._newest is None or self._newest.jpeg != jpeg:
                    self._newest, self.trouble = Picture(jpeg, taken_ns), ""
                    async with self._changed:
                        self._changed.notify_all()
                if time.monotonic() > self._fetched_until_s:
                    return


def cameras(named: Sequence[str]) -> dict[str, Camera]:
    """Return the cameras of `URL` and `NAME=URL`, by name. Raises ConfigError."""
    found = dict[str, Camera]()
    for each in named:
        if (match := _NAMED.fullmatch(each)) is None:
            raise ConfigError("--camera is no URL of an MJPEG stream, such as http://127.0.0.1:8081/stream")
        name = match["name"] or "camera"
        if name in found:
            raise ConfigError(f"--camera {name}: two cameras need two names, such as --camera front=http://…")
        found[name] = Camera(name, match["url"])
    if len(found) > MAX_CAMERAS:
        raise ConfigError(f"--camera: {MAX_CAMERAS} cameras at most")
    return found
