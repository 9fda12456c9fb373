"""A thumb on the pad, while the page, the phone and other drivers do what they do."""

from typing import Any, Final

import pytest
from playwright.sync_api import expect

from tests.console.browser import HIDE, WISHES, Opened, Visitor, walks

pytestmark = pytest.mark.browser

PHONE: Final[dict[str, Any]] = {"viewport": {"width": 360, "height": 640}, "has_touch": True, "is_mobile": True}
STANDS_AGAIN: Final = (
    "() => window.wishes.length > 3 && !window.wishes.some((each) => each.forward_m_s || each.left_m_s)"
)
VISIBLE: Final = """
Object.defineProperty(document, "visibilityState", { value: "visible", configurable: true });
document.dispatchEvent(new Event("visibilitychange"));
"""


class Thumb:
    """One finger on a page, in pixels from the middle of the walk pad as it was when it landed."""

    def __init__(self, page: Opened) -> None:
        self._devtools = page.devtools()
        box = page["pad"].bounding_box()
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


def driving(visitor: Visitor) -> Opened:
    page = visitor.open(script=WISHES, **PHONE)
    page["lease-acquire"].click()
    expect(page["driver"]).to_have_text("you")
    return page


def pushing(page: Opened, down: int) -> Thumb:
    """A thumb that has pushed the pad back, or ahead, until it walks."""
    thumb = Thumb(page)
    walks(page, lambda _: thumb.push(down))
    return thumb


def test_a_thumb_that_is_held_back_does_so_while_a_second_phone_asks_for_the_lease(visitor: Visitor) -> None:
    page, other = driving(visitor), visitor.open()
    thumb = pushing(page, 20)
    other["lease-ask"].click()
    expect(page["lease-hand-over"]).to_be_visible()
    for down in (21, 20, 21, 20):
        thumb.move(0, down)
    page.page.evaluate("window.wishes = []")
    page.page.wait_for_function("() => window.wishes.length > 3")
    walks(page, lambda _: thumb.push(20))
    wishes = page.page.evaluate("window.wishes.map((each) => [each.forward_m_s, each.left_m_s])")
    assert all(ahead <= 0 and aside == 0 for ahead, aside in wishes), (wishes, page.said.text_content())


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


def test_a_touch_that_the_system_takes_stands_still(visitor: Visitor) -> None:
    page = driving(visitor)
    pushing(page, -20).cancel()
    page.page.evaluate("window.wishes = []")
    page.page.wait_for_function(STANDS_AGAIN)
    expect(page.said).to_have_text("It stands still: the system took the touch.")


def test_a_thumb_that_lay_on_the_pad_while_the_page_was_hidden_counts_no_more(visitor: Visitor) -> None:
    page = driving(visitor)
    thumb = Thumb(page)
    page.page.evaluate(HIDE)
    page.page.evaluate(VISIBLE)
    thumb.move(0, -30)
    thumb.cancel()
    assert page.page.evaluate("window.wishes") == []
