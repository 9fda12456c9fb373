"""What one connection of somebody who is not signed in may cost, and who makes room for whom."""

import asyncio
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, cast

import pytest

from gateway.files import durable
from gateway.people.console.server import listener
from gateway.people.console.server.auth import Auth
from gateway.people.console.server.listener import MAX_CONNECTIONS, HttpListener
from gateway.people.console.server.sessions import Sessions
from gateway.people.console.server.site import Site

pytestmark = pytest.mark.full

URL = "http://127.0.0.1:8080"


class Stand:
    """A front on a port of its own."""

    def __init__(self, folder: Path, listening: socket.socket) -> None:
        self.sessions = sessions = Sessions(folder, 8080)
        sessions.begin(f"{URL}/?token=", "operator")
        found = sessions.exchange(sessions.new_link().partition("token=")[2])
        assert found is not None
        self.cookie = f"Cookie: hexapod-console-8080={found[0]}\r\n"
        self.address = listening.getsockname()
        auth = Auth(Site("127.0.0.1", 8080, ("127.0.0.1",)), sessions)
        self.listener = HttpListener(None, auth.answer, cast(Any, None))

    async def ask(self, request: str) -> bytes:
        """The whole answer, until the connection ends."""
        reader, writer = await asyncio.open_connection(*self.address[:2])
        writer.write(request.encode())
        answer = await reader.read()
        writer.close()
        return answer


@pytest.fixture
async def stand(tmp_path: Path) -> AsyncIterator[Stand]:
    with socket.create_server(("127.0.0.1", 0), backlog=200) as taken:
        found = Stand(tmp_path, taken)
        serving = asyncio.create_task(found.listener.serve([taken]))
        yield found
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)


@pytest.mark.parametrize(
    "request_text",
    [
        "POST / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nTransfer-Encoding: chunked\r\n\r\n1\r\nx\r\n",
        "GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\nContent-Length: 5\r\n\r\nabcde",
        "GET / HTTP/1.1\r\nX: " + "y" * 40_000,
        "GET / HTTP/1.1\r\n" + "X: y\r\n" * 4000,
        "\x16\x03\x01 hello",
        "GET / HTTP/9\r\n\r\n",
        "BREW / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n",
    ],
    ids=["chunked", "body", "long line", "many lines", "tls", "version", "method"],
)
async def test_what_no_page_sends_ends_the_connection(stand: Stand, request_text: str) -> None:
    try:
        answer = await stand.ask(request_text)
    except ConnectionError:
        return
    assert not answer or answer.split()[1] in (b"400", b"403", b"405", b"414", b"431")


async def test_a_deadline_for_all_of_it(stand: Stand, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(listener, "UNKNOWN_S", 0.1)
    async with asyncio.timeout(10):
        assert await stand.ask("GET / HTTP/1.1\r\n") == b""


async def test_a_sign_in_that_waits_for_the_disk_delays_nobody(stand: Stand) -> None:
    link = stand.sessions.new_link().removeprefix(URL)
    with durable.locked(stand.sessions.path):
        entering = asyncio.create_task(stand.ask(f"GET {link} HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n"))
        assert (await stand.ask("GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n")).startswith(b"HTTP/1.1 403 ")
        assert not entering.done()
    assert (await entering).startswith(b"HTTP/1.1 303 ")


async def test_strangers_make_room_before_who_is_signed_in(stand: Stand) -> None:
    reader, writer = await asyncio.open_connection(*stand.address[:2])
    strangers: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []
    for count in (MAX_CONNECTIONS, 0):
        writer.write(f"GET /stop.js HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n{stand.cookie}\r\n".encode())
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200 ")
        await reader.readexactly(int(head.lower().partition(b"content-length: ")[2].split()[0]))
        strangers += [await asyncio.open_connection(*stand.address[:2]) for _ in range(count)]
        assert await strangers[0][0].read() == b"", "the oldest stranger makes room for the newest"
    assert (await stand.ask("GET / HTTP/1.1\r\nHost: 127.0.0.1:8080\r\n\r\n")).startswith(b"HTTP/1.1 403 ")
    assert [each.at_eof() for each, _ in strangers] == [True, True] + [False] * (MAX_CONNECTIONS - 2)
    for _, each in strangers:
        each.close()
    writer.close()
