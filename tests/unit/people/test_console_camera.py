"""A camera's stream is cut into pictures of known age; whatever else a server sends costs a bounded amount."""

import asyncio
import itertools
import time
from collections.abc import AsyncIterator, Callable, Iterator
from http.server import BaseHTTPRequestHandler
from typing import Final

import pytest

from gateway.errors import ConfigError
from gateway.people.console.pages.page_walk import PageCamera
from gateway.people.watching import camera
from gateway.people.watching.camera import MAX_JPEG_BYTES, Ages, Camera, CameraError, cameras, stream_parts
from tests.support.camera_server import BOUNDARY, CameraServer, begin, jpeg, part
from tests.support.waiting import wait_until

S: Final = 1_000_000_000
MS: Final = 1_000_000
ONE, TWO = jpeg(1), jpeg(2)
BARE: Final = b"Content-Type: image/jpeg\r\n\r\n"


@pytest.mark.parametrize("chunk", [1, 7, 100_000])
@pytest.mark.parametrize(
    ("boundary", "stream"),
    [
        ("frame", BOUNDARY + part(ONE) + part(TWO)),
        ("--frame", BOUNDARY + part(ONE) + part(TWO)),
        ("frame", BOUNDARY + BARE + ONE + BOUNDARY + BARE + TWO + BOUNDARY),
        ("frame", b"a preamble" + BOUNDARY + part(ONE, X_Other="a: b") + part(TWO)),
    ],
    ids=["by length", "dashes in the boundary", "without a length", "preamble"],
)
async def test_a_stream_is_cut_into_its_pictures_wherever_its_chunks_end(
    boundary: str, stream: bytes, chunk: int
) -> None:
    assert [jpeg async for jpeg in cut(boundary, stream, chunk)] == [ONE, TWO]


async def cut(boundary: str, stream: bytes, chunk: int) -> AsyncIterator[bytes]:
    """Yield the pictures of a stream that comes in chunks. A part is asked for no byte after its last."""
    chunks = (stream[at : at + chunk] for at in range(0, len(stream), chunk))

    async def more() -> bytes:
        return next(chunks)

    parts = stream_parts(more, boundary)
    for _ in range(2):
        _, jpeg = await anext(parts)
        yield jpeg


LARGE: Final = jpeg(1, MAX_JPEG_BYTES)


@pytest.mark.parametrize(
    ("stream", "why"),
    [
        (b"x" * 5000, "no picture that begins"),
        (BOUNDARY + b"X: " + b"y" * 5000, "no picture that begins"),
        (BOUNDARY + b"Content-Type: text/html\r\n\r\n<p>" + BOUNDARY, "other than JPEGs"),
        (BOUNDARY + part(b"GIF89a"), "other than JPEGs"),
        (BOUNDARY + part(b"", Content_Length=10**12), "more than 1 MB"),
        (BOUNDARY + BARE + LARGE, "more than 1 MB"),
        (BOUNDARY + BARE + LARGE + BOUNDARY, "more than 1 MB"),
    ],
)
async def test_anything_but_jpegs_ends_the_stream_with_a_sentence(stream: bytes, why: str) -> None:
    with pytest.raises(CameraError, match=why):
        _ = [jpeg async for jpeg in cut("frame", stream, 100_000)]


@pytest.mark.parametrize(("size", "pictures"), [(0, 4000), (100_000, 160)])
async def test_a_stream_without_end_is_read_slowly_however_small_its_pictures_are(size: int, pictures: int) -> None:
    """After the first second's allowance."""
    chunks = itertools.chain([BOUNDARY], itertools.repeat(100 * part(jpeg(1, size))))

    async def more() -> bytes:
        return next(chunks)

    parts = stream_parts(more, "frame")
    began_s, total = time.monotonic(), 0
    for _ in range(pictures):
        _, found = await anext(parts)
        total += len(found)
    wanted_s = (total + pictures * camera.MAX_HEAD_BYTES) / camera.BYTES_A_SECOND - 1
    assert time.monotonic() - began_s >= 0.9 * wanted_s > 0.5


# ---- ages


def test_a_picture_that_was_delayed_on_its_way_is_older_by_its_servers_clock() -> None:
    ages = Ages()
    assert ages.taken_ns({"x-timestamp": "1000"}, 50 * S) == 50 * S
    assert ages.taken_ns({"x-timestamp": "1000.1"}, 51 * S) == pytest.approx(50.1 * S, abs=MS)
    assert ages.taken_ns({"x-timestamp": "1002"}, 52 * S) == pytest.approx(52 * S, abs=MS)


def test_what_the_server_states_of_its_camera_counts() -> None:
    assert Ages().taken_ns({"x-timestamp": "1000", "x-ustreamer-latency": "0.25"}, 50 * S) == 49.75 * S
    assert Ages().taken_ns({"x-timestamp": "yesterday", "x-ustreamer-latency": "-3"}, 50 * S) == 50 * S


def test_drifting_clocks_make_no_picture_old_and_a_clock_that_is_set_begins_anew() -> None:
    ages = Ages()
    for at_s in range(0, 36_000, 100):
        taken_ns = ages.taken_ns({"x-timestamp": str(1000 + at_s * (1 - 100e-6))}, at_s * S)
        assert taken_ns == pytest.approx(at_s * S, abs=MS)
    with pytest.raises(CameraError, match="clock was set"):
        ages.taken_ns({"x-timestamp": "1000"}, 36_000 * S)


def test_a_page_is_barred_by_the_picture_that_it_shows() -> None:
    page = PageCamera(500)
    assert page.bars(0) == ""
    page.show("front")
    assert "no picture was shown yet" in page.bars(0)
    page.sent = camera.Picture(ONE, 0)
    for name, number in (("rear", "0"), ("front", "1"), ("front", "")):
        page.confirm(name, number)
        assert "no picture was shown yet" in page.bars(0)
    page.confirm("front", "0")
    page.show("front")
    assert page.bars(499 * MS) == ""
    assert page.bars(500 * MS) == "the picture was 0.5 s old"
    assert page.bars(720 * MS) == "the picture was 0.7 s old"
    page.show("rear")
    page.confirm("rear", "0")
    assert "no picture was shown yet" in page.bars(0)
    page.show(None)
    assert page.bars(720 * MS) == ""
    page = PageCamera(0)
    page.show("front")
    assert page.bars(10 * S) == "", "an age of 0: any picture moves"


# ---- the option


def test_cameras_have_names_and_addresses() -> None:
    urls = (
        "http://127.0.0.1:8081/?action=stream",
        "rear=https://user:pass@cam.example/mjpeg?a=b",
        "v6=http://[::1]:80",
    )
    assert [*cameras([*urls, "l=http://bücher.local?x=http://y"])] == ["camera", "rear", "v6", "l"]


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (["front=ftp://a/b"], "no URL"),
        (["/dev/video0"], "no URL"),
        (["http://"], "no URL"),
        (["http://[::1/x"], "no URL"),
        (["http:///x"], "no URL"),
        (["http://user:pass@/x"], "no URL"),
        (["http://a:b/"], "no URL"),
        (["http://a/\n"], "no URL"),
        (["http://a/1", "http://a/2"], "two cameras need two names"),
        ([f"c{number}=http://a/" for number in range(5)], "4 cameras at most"),
    ],
)
def test_a_camera_that_cannot_be_fetched_is_rejected_without_its_password(given: list[str], why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        cameras(given)


# ---- a real server


@pytest.fixture
def server() -> Iterator[CameraServer]:
    with CameraServer() as running:
        yield running


@pytest.fixture(autouse=True)
def _quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera, "SILENT_S", 0.3)
    monkeypatch.setattr(camera, "AGAIN_S", 0.02)


async def trouble(found: Camera) -> str:
    last: camera.Picture | None = None
    async with asyncio.timeout(20):
        while not found.trouble:
            last = await found.newer(last, 0.01) or last
        return found.trouble


async def picture(found: Camera) -> camera.Picture:
    newer = await found.newer(None, 20)
    assert newer is not None
    return newer


async def test_pictures_are_fetched_once_for_all_and_only_while_somebody_asks(server: CameraServer) -> None:
    found = cameras([server.url])["camera"]
    assert server.requests == 0
    first, _ = await asyncio.gather(picture(found), picture(found))
    second = await found.newer(first, 0.3)
    assert second is not None
    assert second.jpeg > first.jpeg
    assert 0 <= time.monotonic_ns() - second.taken_ns < S
    await asyncio.to_thread(wait_until, lambda: not server.open)
    assert server.requests == 1
    assert (await picture(found)).taken_ns > second.taken_ns
    assert server.requests == 2


def drips(server: CameraServer, handler: BaseHTTPRequestHandler) -> None:
    begin(handler)
    for _ in server.ticks():
        handler.wfile.write(b"x")


def moved(handler: BaseHTTPRequestHandler, to: str) -> None:
    handler.send_response(302)
    handler.send_header("Location", to)
    handler.end_headers()


def sends(handler: BaseHTTPRequestHandler, data: bytes) -> None:
    begin(handler)
    handler.wfile.write(data)


BAD: Final[dict[str, Callable[[CameraServer, BaseHTTPRequestHandler], object]]] = {
    "has sent no picture for": drips,
    "redirects to another address": lambda _, to: moved(to, "http://192.0.2.1/stream"),
    "HTTP status 404": lambda _, to: to.send_error(404),
    "no MJPEG stream": lambda _, to: begin(to, "text/html"),
    "has ended its stream": lambda _, to: sends(to, b""),
    "is not connected to its server": lambda _, to: sends(to, part(ONE, X_UStreamer_Online="false")),
    "cannot be reached": lambda _, to: to.wfile.write(b"\0" * 100_000),
}


@pytest.mark.parametrize("why", BAD)
async def test_a_bad_server_is_named_in_a_sentence_and_tried_again(why: str, server: CameraServer) -> None:
    server.answer = lambda handler: BAD[why](server, handler)
    found = cameras([f"front={server.url}"])["front"]
    assert why in await trouble(found)
    server.answer = None
    await picture(found)
    assert found.trouble == ""


async def test_a_picture_that_is_sent_again_byte_for_byte_is_as_old_as_before(server: CameraServer) -> None:
    def repeats(handler: BaseHTTPRequestHandler) -> None:
        begin(handler)
        for number in server.ticks():
            handler.wfile.write(part(jpeg(min(number, 5))))
            if number == 30:
                server.frozen.set()

    server.answer = repeats
    found = cameras([server.url])["camera"]
    last = await picture(found)
    while last.jpeg != jpeg(5):
        last = await found.newer(last, 20) or last
    assert "has sent no picture" in await trouble(found)
    assert (await picture(found)).taken_ns == last.taken_ns
