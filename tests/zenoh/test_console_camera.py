"""A page that shows a camera drives only by a fresh picture, and the console decides; a real gateway, a real server."""

import socket
from collections.abc import Iterator
from concurrent import futures
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import httpx
import pytest

from gateway.client import Client
from gateway.people.console.server.sessions import Sessions
from tests.support.camera_server import CameraServer
from tests.support.console_process import NOBODY, Console, Page, SignedIn
from tests.support.fixtures import camera_fixture, client_fixture, gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway
from tests.support.waiting import Closing, meanwhile, wait_until
from tests.zenoh.test_console_walk import STEP_S, Pad, acquire, gets, is_free, posture, stands, walk, walks

OLD: Final = "the picture was "

gateway = gateway_fixture(patient())
session = session_fixture()
camera = camera_fixture()
robot = client_fixture("watcher", rests=True)


@pytest.fixture(scope="module")
def console(gateway: Gateway, camera: CameraServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """Start a console. Pictures count for twice as long: a busy machine delays them, too."""
    with CameraServer(size=900_000) as large:
        cameras = ("--camera", f"front={camera.url}", "--camera", f"large={large.url}", "--camera-stale-ms", "1000")
        with Console(tmp_path_factory.mktemp("console"), "--connect", gateway.endpoint, *cameras) as running:
            yield running


class Shown(Closing):
    """A camera that a page shows."""

    def __init__(self, console: Console, session: SignedIn, page: Page) -> None:
        self._url = f"{console.url}/camera/front"
        self._client = httpx.Client(headers=session.headers, timeout=60)
        self._secret = page.hello["page"]
        self._number = ""
        page.send(type="camera", shown="front")

    def close(self) -> None:
        self._client.close()

    def ask(self) -> httpx.Response:
        """Ask for a picture, as a page that shows the one before."""
        answer = self._client.get(self._url, params={"page": self._secret, "shown": self._number})
        self._number = answer.headers.get("x-picture", "")
        return answer

    def next(self) -> httpx.Response:
        """Ask until there is a picture."""
        while (answer := self.ask()).status_code == 202:
            pass
        assert answer.status_code == 200
        return answer


def test_a_picture_that_stands_still_moves_nothing_and_a_new_press_by_a_fresh_one_goes_on(
    console: Console, session: SignedIn, camera: CameraServer, robot: Client
) -> None:
    with console.page(session) as page, Shown(console, session, page) as shown:
        assert (page.hello["cameras"], page.hello["stale_ms"]) == (["front", "large"], 1000)
        is_free(page)
        acquire(page)
        pad = Pad(page)
        pad.hold(forward_m_s=0.06)
        pad.send()
        rejected = walk(page, lambda message: message["press"] == pad.press)
        assert rejected["posture"] is None, "no walk begins"
        assert "no picture was shown yet" in rejected["detail"]
        shown.next()  # on its way: the page shows it once it asks for the next
        answer = page.ask("hexapod/leg/3/cmd", {"servos": [{"op": "start", "angle_deg": 90}] * 3})
        assert "no picture was shown yet" in answer["ack"]["detail"]
        shown.next()
        with meanwhile(pad.send, STEP_S):
            with meanwhile(shown.next):
                walks(page, pad)
            # the page asks for no further picture, as one whose picture hangs
            barred = walk(page, lambda message: OLD in message["detail"])
            assert (barred["commanded"], barred["waits"]) == ([0, 0, 0], True)
            posture(page, "standing")
            gets(page, pad, stands)  # Stand
            camera.frozen.set()
            try:
                pad.hold(forward_m_s=0.06)
                assert OLD in walk(page, lambda message: message["press"] == pad.press)["detail"]
            finally:
                camera.frozen.clear()
            with meanwhile(shown.next):
                walks(page, pad)
            page.send(type="camera", shown=None)
            walks(page, pad)
            pad.hold(sits=True)
            assert page.stop_all()["answered"]
            assert page.reset(robot.state().estop)["ack"]["accepted"]
        page.send(type="lease", id=2, do="release")
        assert not page.answer("lease", 2)["mine"]


def test_pictures_come_one_by_one_with_their_age(console: Console, session: SignedIn) -> None:
    with console.page(session) as page, Shown(console, session, page) as shown:
        first, second = shown.next(), shown.next()
        for each in (first, second):
            assert -60_000 < float(each.headers["x-taken-ms"]) < 1000, "before the request, or while it waited"
            assert each.headers["content-type"] == "image/jpeg"
            assert each.content.startswith(b"\xff\xd8")
        assert first.content < second.content


def test_only_an_open_page_of_a_session_sees_it(console: Console, session: SignedIn) -> None:
    """The cookie is not enough: browsers send it to every port of the host."""
    with console.page(session) as page:
        secret, stranger = page.hello["page"], session._replace(cookie=session.cookie + "x")
        assert len(secret) >= 43, "256 bits"
        assert status(console, session, page="") == status(console, session, page=secret[:-1]) == 403
        assert status(console, NOBODY, page=secret) == status(console, stranger, page=secret) == 403
        assert status(console, session, "other", page=secret) == 409
        assert status(console, session, page=secret) == 200
    wait_until(lambda: status(console, session, page=secret) == 403, "the page is closed")


def status(console: Console, session: SignedIn, camera: str = "front", **query: str) -> int:
    """Return the answer's status to a request for a picture."""
    url = f"{console.url}/camera/{camera}"
    while (answer := httpx.get(url, params=query, headers=session.headers, timeout=60)).status_code == 202:
        pass
    return answer.status_code


def test_a_page_has_one_request_at_a_time_also_while_it_does_not_read(console: Console, session: SignedIn) -> None:
    with console.page(session) as page, socket.create_connection(("127.0.0.1", console.port)) as slow:
        secret = page.hello["page"]
        request = f"GET /camera/large?page={secret} HTTP/1.1\r\nHost: 127.0.0.1:{console.port}\r\n"
        slow.sendall(f"{request}Cookie: {session.cookie}\r\n\r\n".encode())
        assert slow.recv(12) == b"HTTP/1.1 200"
        assert status(console, session, page=secret) == 409
        with console.page(session) as other:
            assert status(console, session, page=other.hello["page"]) == 200
    # its connection has ended
    with console.page(session) as page:
        assert status(console, session, "large", page=page.hello["page"]) == 200


def test_a_session_that_is_signed_out_gets_no_picture(gateway: Gateway, camera: CameraServer, tmp_path: Path) -> None:
    """A request that waits for a picture gets none, too."""
    with Console(tmp_path, "--connect", gateway.endpoint, "--camera", f"front={camera.url}") as console:
        session = console.sign_in()
        with console.page(session) as page, ExitStack() as stack:
            shown = [stack.enter_context(Shown(console, session, page)) for _ in range(2)]
            waiting = stack.enter_context(ThreadPoolExecutor(2))
            shown[0].next()
            stack.callback(camera.frozen.clear)
            camera.frozen.set()
            while shown[0].ask().status_code != 202:
                pass
            rejected, waits = futures.wait([waiting.submit(each.ask) for each in shown], return_when=FIRST_COMPLETED)
            assert [each.result().status_code for each in rejected] == [409]
            Sessions(tmp_path, console.port).revoke()
            camera.frozen.clear()
            assert [each.result().status_code for each in waits] == [403]
            assert shown[0].ask().status_code == 403
