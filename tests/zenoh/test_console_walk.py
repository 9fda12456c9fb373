"""A page walks: its wishes come to a real gateway 20 times a second; whatever silences it makes the robot stand."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import pytest
from websockets.exceptions import ConnectionClosed

from gateway.client import Client
from schemas.words import Kind
from tests.support.console_process import TRIES, Console, Page, SignedIn
from tests.support.fixtures import client_fixture, console_fixture, gateway_fixture, patient, session_fixture
from tests.support.gateway_process import Gateway
from tests.support.heard import events
from tests.support.waiting import meanwhile

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
console = console_fixture()
session = session_fixture()


robot = client_fixture("watcher", rests=True)


@pytest.fixture
def page(console: Console, session: SignedIn) -> Iterator[Page]:
    with console.page(session) as opened:
        is_free(opened)
        acquire(opened)
        yield opened


@pytest.fixture
def pad(page: Page) -> Iterator[Pad]:
    held = Pad(page)
    with meanwhile(held.send, STEP_S):
        yield held


def acquire(page: Page) -> None:
    page.send(type="lease", id=1, do="acquire")
    assert page.answer("lease", 1)["mine"]


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


def test_a_page_that_falls_silent_stands_and_goes_on_with_a_new_press_only_and_one_that_is_closed_sits(
    console: Console, session: SignedIn, robot: Client
) -> None:
    """When: tests/unit/people/test_ride.py. A wish that was delayed counts as none. At last the lease is given back."""
    with console.page(session) as page, console.page(session) as other:
        is_free(page)
        acquire(page)
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
    page.send(type="lease", id=2, do="release")
    page.state(lambda state: state["mode"] == "idle")
    assert not page.answer("lease", 2)["mine"]


def test_the_robot_sits_down_before_a_console_that_is_stopped_ends(
    gateway: Gateway, tmp_path: Path, robot: Client
) -> None:
    heard = events(robot)
    with Console(tmp_path, "--connect", gateway.endpoint) as own:
        page = own.page(own.sign_in())
        acquire(page)
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
