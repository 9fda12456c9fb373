"""A page walks: its wishes come to a real gateway 20 times a second; whatever silences it makes the robot stand.

One that shows a camera of a real server walks only by a fresh picture, and the console decides.
"""

import itertools
import socket
from collections.abc import Callable, Iterator
from concurrent import futures
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

import httpx
import pytest
from websockets.exceptions import ConnectionClosed

from gateway.client import Client
from gateway.people.console.server.sessions import Sessions
from schemas.words import Kind
from tests.support.camera_server import CameraServer
from tests.support.console_process import NOBODY, TRIES, Console, Page, SignedIn
from tests.support.fixtures import camera_fixture, client_fixture, gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import events
from tests.support.waiting import Closing, meanwhile, wait_until

pytestmark = pytest.mark.usefixtures("robot")
FORWARD: Final = {"forward_m_s": 0.06}
STEP_S: Final = 0.05


class Pad:
    """What a page has while its pad is held."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._ids = itertools.count(1)
        self.press = 0
        self.delay_ms = 0.0
        """What a wish takes to come."""
        self.wish: dict[str, Any] = {}

    def hold(self, **wish: Any) -> None:
        """Begin a new press with this wish."""
        self.wish = wish
        self.press += 1

    def send(self) -> None:
        """Send the wish. Call it 20 times a second."""
        if self.press:
            sent_ms = self._page.now_ms() - self.delay_ms
            self._page.send(type="walk", id=next(self._ids), press=self.press, sent_ms=sent_ms, **self.wish)


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


@pytest.fixture
def page(console: Console, session: SignedIn) -> Iterator[Page]:
    with console.page(session) as opened:
        is_free(opened)
        assert opened.lease("acquire")["mine"]
        yield opened


@pytest.fixture
def pad(page: Page) -> Iterator[Pad]:
    held = Pad(page)
    with meanwhile(held.send, STEP_S):
        yield held


def walk(page: Page, fits: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Return the next report of the walk that fits."""
    return page.wait("walk", fits)


def posture(page: Page, wanted: str | None) -> dict[str, Any]:
    return walk(page, lambda message: message["posture"] == wanted)


def gets(page: Page, pad: Pad, fits: Callable[[dict[str, Any]], bool], **wish: Any) -> dict[str, Any]:
    """Hold until a report fits. If a busy machine delayed the wishes, which uses up the press, press again."""
    for _ in range(TRIES):
        pad.hold(**wish)
        found = walk(page, lambda message: message["press"] == pad.press and (message["waits"] or fits(message)))
        if not found["waits"]:
            return found
    raise AssertionError("it was held up time and again")


def stands(message: dict[str, Any]) -> bool:
    return bool(message["posture"] == "standing")


def walks(page: Page, pad: Pad) -> None:
    gets(page, pad, lambda message: message["posture"] == "walking", **FORWARD)


def is_free(page: Page) -> None:
    page.state(lambda state: state["mode"] == "idle" and state["lease"]["holder"] is None)


# ---- by a camera

OLD: Final = "the picture was "


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
        assert page.lease("acquire")["mine"]
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
        assert not page.lease("release")["mine"]


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


# ---- without a camera


def test_a_page_that_falls_silent_stands_and_goes_on_with_a_new_press_only_and_one_that_is_closed_sits(
    console: Console, session: SignedIn, robot: Client
) -> None:
    """When: tests/unit/people/test_ride.py. A wish that was delayed counts as none. At last the lease is given back."""
    with console.page(session) as page, console.page(session) as other:
        is_free(page)
        assert page.lease("acquire")["mine"]
        pad = Pad(page)
        with meanwhile(pad.send, STEP_S):
            walks(page, pad)
            assert robot.state().legs[0].source == f"{page.hello['source']} walks"
            pad.delay_ms = 300
            still = walk(page, lambda message: message["commanded"] == [0, 0, 0])
            assert still["waits"]
            standing = posture(page, "standing")
            assert standing["id"] >= still["id"]
            pad.delay_ms = 0
            last = standing["id"] + 20  # a second: it is received, and so does not sit down, and does not walk
            later = walk(page, lambda now: not (stands(now) and now["waits"]) or (now["id"] or 0) > last)
            assert (stands(later), later["waits"]) == (True, True)
            walks(page, pad)
        page.socket.close()
        other.state(lambda state: state["lease"]["holder"] is not None)
        is_free(other)


def test_who_gives_the_lease_up_sits_down_first_and_meanwhile_joints_wait(
    console: Console, session: SignedIn, page: Page, pad: Pad
) -> None:
    with console.page(session) as other:
        other.state()
        other.send(type="walk", id=1, press=1, sent_ms=other.now_ms(), **FORWARD)
        assert "does not have the lease" in walk(other, lambda _: True)["detail"]
    pad.hold(height_m=0.9)
    assert "it cannot stand" in walk(page, lambda message: message["detail"] != "")["detail"]
    found = gets(
        page, pad, lambda now: now["posture"] == "walking" and now["limit"] != "", forward_m_s=0.9, gait="wave"
    )
    assert (found["commanded"], found["gait"]) == ([0.9, 0, 0], "wave")
    assert found["scaled"][0] < 0.5
    answer = page.ask("hexapod/leg/3/cmd", {"servos": [{"op": "set", "angle_deg": 90}] * 3})
    assert "this page walks" in answer["error"]
    assert not page.lease("release")["mine"]
    page.state(lambda state: state["mode"] == "idle")


def test_the_robot_sits_down_before_a_console_that_is_stopped_ends(
    gateway: Gateway, tmp_path: Path, robot: Client
) -> None:
    heard = events(robot)
    with Console(tmp_path, "--connect", gateway.endpoint) as own:
        page = own.page(own.sign_in())
        assert page.lease("acquire")["mine"]
        pad = Pad(page)

        def send() -> None:
            with suppress(ConnectionClosed):  # the console closes the link before its process ends
                pad.send()

        with meanwhile(send, STEP_S):
            walks(page, pad)
            own.child.terminate()
            own.child.wait()
        page.close()
    assert robot.state().mode == "idle"
    heard.wait(lambda event: event.kind in (Kind.LEASE_RELEASED, Kind.LEASE_EXPIRED))
    assert not [event for event in heard.all if event.kind == Kind.WATCHDOG_EXPIRED]


def test_after_a_stop_of_somebody_else_only_a_new_press_walks(page: Page, pad: Pad, robot: Client) -> None:
    walks(page, pad)
    assert robot.stop(3).accepted
    halted = posture(page, "halted")
    assert halted["lost"] == [3]
    assert halted["now"] == "Leg 3 is stopped, and the others stand still"
    assert walk(page, lambda message: message["detail"] != "")["detail"] == "watcher stopped leg 3"
    assert not robot.state().legs[2].servos[0].running
    walks(page, pad)
    assert robot.stop(3).accepted
    posture(page, "halted")
    robot.estop()
    walk(page, lambda message: message["detail"] == "the emergency stop was engaged by watcher")
    stopped = page.wait("state", lambda message: message["state"]["mode"] == "estopped")
    assert stopped["now"] == "Emergency stop by watcher: nothing runs until a reset"
    assert page.reset(robot.state().estop)["ack"]["accepted"]
    page.state(lambda state: state["mode"] == "idle")
    assert page.wait("state", lambda _: True)["now"] == "No servo runs"
    for _ in range(10):
        assert page.state()["mode"] == "idle"
    walks(page, pad)
