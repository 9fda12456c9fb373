"""A page that shows a camera drives only by a fresh picture, and the console decides; a real gateway, a real server."""

import struct
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Final

import httpx
import pytest

from gateway.client import Client
from tests.support.camera_server import CameraServer
from tests.support.console_process import NOBODY, Console, Page, SignedIn, opened
from tests.support.fixtures import camera_fixture, client_fixture, gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway
from tests.support.waiting import Closing, meanwhile
from tests.zenoh.test_console_walk import STEP_S, Pad, acquire, gets, is_free, posture, stands, walk, walks

OLD: Final = "the picture was "

gateway = gateway_fixture(patient())
session = session_fixture()
camera = camera_fixture()
robot = client_fixture("watcher", rests=True)


@pytest.fixture(scope="module")
def console(gateway: Gateway, camera: CameraServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Console]:
    """Start a console. Pictures count for twice as long: a busy machine delays them, too."""
    arguments = ("--connect", gateway.endpoint, "--camera", f"front={camera.url}", "--camera-stale-ms", "1000")
    with Console(tmp_path_factory.mktemp("console"), *arguments) as running:
        yield running


class Shown(Closing):
    """A camera that a page shows, with its own WebSocket."""

    def __init__(self, console: Console, session: SignedIn, page: Page) -> None:
        with ExitStack() as stack:
            path = f"camera/front?page={page.hello['page']}&"
            self.socket = stack.enter_context(opened(console.url, session, path=path))
            page.send(type="camera", shown="front")
            self._stack = stack.pop_all()

    def close(self) -> None:
        self._stack.close()

    def next(self) -> tuple[float, bytes]:
        """Ask for a picture, and return its age and its JPEG."""
        self.socket.send("next")
        while isinstance(found := self.socket.recv(timeout=60), str):
            pass
        return struct.unpack("<f", found[:4])[0], found[4:]


def test_a_picture_that_stands_still_moves_nothing_and_a_new_press_by_a_fresh_one_goes_on(
    console: Console, session: SignedIn, camera: CameraServer, robot: Client
) -> None:
    with console.page(session) as page, Shown(console, session, page) as shown:
        assert (page.hello["cameras"], page.hello["stale_ms"]) == (["front"], 1000)
        is_free(page)
        acquire(page)
        pad = Pad(page)
        pad.hold(forward_m_s=0.06)
        pad.send()
        assert "no picture was shown yet" in walk(page, lambda message: message["press"] == pad.press)["detail"]
        answer = page.ask("hexapod/leg/3/cmd", {"servos": [{"op": "start", "angle_deg": 90}] * 3})
        assert "no picture was shown yet" in answer["ack"]["detail"]
        for _ in range(2):
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
        assert not page.wait("lease", lambda message: message["id"] == 2)["mine"]


def test_only_a_page_that_is_signed_in_sees_it(console: Console, session: SignedIn) -> None:
    for path, someone in (("camera/front?", NOBODY), ("camera/other?", session)):
        with pytest.raises(Exception, match=r"HTTP 40[34]"):
            opened(console.url, someone, path=path)
    assert httpx.get(f"{console.url}/camera/front", headers=session.headers).status_code == 403


def test_pictures_come_one_by_one_with_their_age_and_anything_but_next_ends_it(
    console: Console, session: SignedIn
) -> None:
    with console.page(session) as page, Shown(console, session, page) as shown:
        first, second = shown.next(), shown.next()
        for age_ms, jpeg in (first, second):
            assert 0 <= age_ms < 60_000
            assert jpeg.startswith(b"\xff\xd8")
        assert first[1] < second[1]
        shown.socket.send("all")
        with pytest.raises(Exception, match="a page sends next here"):
            shown.socket.recv(timeout=60)
