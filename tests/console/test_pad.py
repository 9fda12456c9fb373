"""A thumb on the pad, while the page, the phone and other drivers do what they do."""

from typing import Final

import pytest
from playwright.sync_api import CDPSession, expect

from tests.console.browser import COUNTS, PHONE, WISHES, Opened, Visitor, walks
from tests.support.fixtures import client_fixture

pytestmark = pytest.mark.browser

STANDS_AGAIN: Final = (
    "() => window.wishes.length > 3 && !window.wishes.some((each) => each.forward_m_s || each.left_m_s)"
)


class Thumb:
    """One finger on a page, in pixels from the middle of a pad as it was when it landed."""

    def __init__(self, page: Opened, pad: str = "pad") -> None:
        self._devtools = page.devtools()
        box = page[pad].bounding_box()
        assert box is not None
        self._x, self._y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.land()

    def land(self) -> None:
        """In the middle."""
        self._touch("touchStart", 0, 0)

    def move(self, x: float, y: float) -> None:
        """To the right, and down."""
        self._touch("touchMove", x, y)

    def push(self, down: float) -> None:
        """Anew, from the same place."""
        self.cancel()
        self.land()
        self.move(0, down)

    def cancel(self) -> None:
        """The system takes the touch, for a gesture of its own."""
        self._devtools.send("Input.dispatchTouchEvent", {"type": "touchCancel", "touchPoints": []})

    def _touch(self, kind: str, x: float, y: float) -> None:
        self._devtools.send(
            "Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": self._x + x, "y": self._y + y}]}
        )


robot = client_fixture("watcher")


def driving(visitor: Visitor) -> Opened:
    page = visitor.open(script=WISHES + COUNTS, **PHONE)
    page.get_lease()
    return page


def pushing(page: Opened, down: int) -> Thumb:
    """A thumb that has pushed the pad back, or ahead, until it walks."""
    thumb = Thumb(page)
    walks(page, lambda _: thumb.push(down))
    return thumb


def test_a_thumb_that_lands_anywhere_on_the_pad_pushes_from_there(visitor: Visitor) -> None:
    page = driving(visitor)
    thumb = Thumb(page)
    thumb.cancel()
    box = page["pad"].bounding_box()
    assert box is not None
    page.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 0.9 * box["height"])
    page.page.mouse.down()
    page.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 0.6 * box["height"])
    page.page.wait_for_function("() => window.wishes.some((each) => each.forward_m_s > 0)")
    assert not page.page.evaluate("window.wishes.some((each) => each.forward_m_s < 0)")
    page.page.mouse.up()


def test_a_phone_that_is_turned_while_it_walks_stands_still(visitor: Visitor) -> None:
    page = driving(visitor)
    thumb = pushing(page, -20)
    page.page.set_viewport_size({"width": 640, "height": 360})
    page.page.wait_for_function("() => innerWidth === 640")
    page.page.evaluate("window.wishes = []")
    for away in (1, 2, 3, 60):
        thumb.move(away, -20)
    page.page.wait_for_function(STANDS_AGAIN)
    expect(page.said).to_have_text("It stands still: the page moved under the thumb.")
    expect(page["pad"]).to_have_attribute("data-held", "no")


def throttle(devtools: CDPSession, bytes_a_second: int) -> None:
    """What the page receives; -1: as fast as it comes."""
    devtools.send("Network.enable")
    speeds = {"downloadThroughput": bytes_a_second, "uploadThroughput": -1}
    devtools.send("Network.emulateNetworkConditions", {"offline": False, "latency": 0, **speeds})


@pytest.mark.nightly
def test_a_network_that_is_throttled_while_it_walks_stands_still_until_a_new_press(visitor: Visitor) -> None:
    page = driving(visitor)
    thumb = pushing(page, -20)
    devtools = page.devtools()
    throttle(devtools, 1500)
    expect(page["pad"]).to_have_attribute("data-held", "no")
    expect(page["quality"]).to_have_attribute("data-bars", "0")
    expect(page.said).to_contain_text("It stands still")
    page.page.evaluate("window.wishes = []")
    throttle(devtools, -1)
    page.expect_live()
    thumb.move(0, -30)
    expect(page["walk-known"]).not_to_contain_text("It walks")
    assert not page.page.evaluate("window.wishes.some((each) => each.forward_m_s || each.left_m_s)")
    expect(page["quality"]).not_to_have_attribute("data-bars", "0")
    expect(page["driver"]).to_have_text("you")
    walks(page, lambda _: thumb.push(-20))


@pytest.mark.nightly
def test_a_driver_has_a_screen_that_stays_on_and_feels_what_ends_a_walk(visitor: Visitor) -> None:
    page = driving(visitor)
    page.page.wait_for_function("() => window.wakes === 1")
    thumb = pushing(page, -20)
    page.page.evaluate("window.shakes = []")
    thumb.cancel()
    page.page.wait_for_function("() => window.shakes.length === 1")
    page.hide()
    page.show()
    page.page.wait_for_function("() => window.wakes === 2")
    page.page.evaluate("window.shakes = []")
    page["stop-all"].tap()
    page.page.wait_for_function("() => window.shakes.length > 0")
