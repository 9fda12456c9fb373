"""A thumb on the pad, while the page, the phone and other drivers do what they do."""

from typing import Final

import pytest
from playwright.sync_api import expect

from tests.console.browser import COUNTS, PHONE, WISHES, Opened, Visitor, walks

pytestmark = pytest.mark.browser

STANDS_AGAIN: Final = (
    "() => window.wishes.length > 3 && !window.wishes.some((each) => each.forward_m_s || each.left_m_s)"
)


class Thumb:
    """One finger on a page, in pixels from the middle of a pad as it was when it landed."""

    def __init__(self, page: Opened) -> None:
        self._devtools = page.devtools()
        box = page["pad"].bounding_box()
        assert box is not None
        self._x, self._y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.land()

    def land(self) -> None:
        """Put the finger in the middle."""
        self._touch("touchStart", 0, 0)

    def move(self, x: float, y: float) -> None:
        self._touch("touchMove", x, y)

    def push(self, down: float) -> None:
        """Put the finger down again, at the same place."""
        self.cancel()
        self.land()
        self.move(0, down)

    def cancel(self) -> None:
        """Let the system take the touch for a gesture of its own."""
        self._devtools.send("Input.dispatchTouchEvent", {"type": "touchCancel", "touchPoints": []})

    def _touch(self, kind: str, x: float, y: float) -> None:
        self._devtools.send(
            "Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": self._x + x, "y": self._y + y}]}
        )


def driving(visitor: Visitor) -> Opened:
    page = visitor.open(script=WISHES + COUNTS, **PHONE)
    page.get_lease()
    return page


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
    page.page.wait_for_function("() => window.wakes === 1")  # its screen stays on
    thumb = Thumb(page)
    walks(page, lambda _: thumb.push(-20))
    page.page.evaluate("window.shakes = []")
    page.page.set_viewport_size({"width": 640, "height": 360})
    page.page.wait_for_function("() => innerWidth === 640")
    page.page.evaluate("window.wishes = []")
    for away in (1, 2, 3, 60):
        thumb.move(away, -20)
    page.page.wait_for_function(STANDS_AGAIN)
    expect(page.said).to_have_text("It stands still: the page moved under the thumb.")
    expect(page["pad"]).to_have_attribute("data-held", "no")
    assert page.page.evaluate("window.shakes.length") > 0
