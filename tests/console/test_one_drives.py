"""One thing drives at a time: what was pushed beside it moves nothing until it is let go and pushed anew.

And a thumb on the pad of a phone, while that is turned.
"""

import re
from collections.abc import Callable
from typing import Final, NamedTuple

import pytest
from playwright.sync_api import expect

from gateway.client import Client
from tests.console.browser import COUNTS, GAMEPAD, MOVES, PHONE, WISHES, Opened, Visitor, expect_still, push, walks
from tests.support.heard import servos_on, states

pytestmark = pytest.mark.browser

PADS: Final = f"""{GAMEPAD}
const get = navigator.getGamepads;
navigator.getGamepads = () => {{
  for (const each of window.pads) if (each && each !== window.pad) each.timestamp += 1;
  return get();
}};
"""
"""Each of the three reports all the time."""
SHORT_MS: Final = 20
PRESSES: Final = 200


def evaluate(page: Opened, script: str) -> None:
    """Evaluate a script, and let the page poll its gamepads a few times."""
    page.page.evaluate(f"() => {{ {script}; window.looks = 0; }}")
    page.page.wait_for_function("() => window.looks > 3")


def push_stick(number: int) -> Callable[[Opened], None]:
    def push(page: Opened) -> None:
        for deflection in (0, -1):
            evaluate(page, f"window.pads[{number}].axes[1] = {deflection}")

    return push


class Control(NamedTuple):
    """How a person pushes something forward, and lets go of it."""

    push: Callable[[Opened], None]
    let_go: Callable[[Opened], None]


THUMB: Final = Control(push, lambda page: page.page.mouse.up())
KEY: Final = Control(lambda page: page.page.keyboard.down("w"), lambda page: page.page.keyboard.up("w"))
FIRST: Final = Control(push_stick(0), lambda page: evaluate(page, "window.pads[0].axes[1] = 0"))
UNPLUGGED: Final = Control(push_stick(0), lambda page: evaluate(page, "window.pads[0] = null"))
SECOND: Final = Control(push_stick(1), lambda page: evaluate(page, "window.pads[1].axes[1] = 0"))


def press_of_a_move(page: Opened) -> int:
    page.page.evaluate("window.wishes = []")
    page.page.wait_for_function(f"() => window.wishes.some({MOVES})")
    return int(page.page.evaluate(f"window.wishes.find({MOVES}).press"))


@pytest.mark.parametrize(
    ("drives", "beside"),
    [(UNPLUGGED, SECOND), (FIRST, SECOND), (THUMB, KEY), (KEY, THUMB), (FIRST, THUMB), (THUMB, FIRST), (KEY, FIRST)],
    ids=[
        "a gamepad that is unplugged, and another",
        "two gamepads",
        "thumb and key",
        "key and thumb",
        "gamepad and thumb",
        "thumb and gamepad",
        "key and gamepad",
    ],
)
def test_what_is_pushed_beside_what_drives_needs_a_push_of_its_own(
    visitor: Visitor, drives: Control, beside: Control
) -> None:
    page = visitor.open(script=PADS + WISHES)
    page.get_lease()
    drives.push(page)
    press = press_of_a_move(page)
    beside.push(page)
    assert press_of_a_move(page) == press, "what drives goes on"
    page.page.evaluate("window.wishes = []")
    drives.let_go(page)
    expect_still(page)
    beside.let_go(page)
    beside.push(page)
    assert press_of_a_move(page) > press
    beside.let_go(page)
    expect_still(page)


def test_a_gamepad_in_the_place_of_another_needs_a_push_of_its_own(visitor: Visitor) -> None:
    """Browsers give the number of one that was unplugged to the next."""
    page = visitor.open(script=PADS + WISHES)
    page.get_lease()
    push_stick(0)(page)
    press = press_of_a_move(page)
    evaluate(page, "window.pad = window.pads[0] = { ...window.pads[0], id: 'Another' }")
    expect_still(page)
    push_stick(0)(page)
    assert press_of_a_move(page) > press


def test_the_trigger_of_another_gamepad_runs_no_leg_that_the_first_one_ran(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open(script=PADS)
    page.drive()
    evaluate(page, "window.pads[0].buttons[7].value = 1")
    states(watcher).wait(lambda state: servos_on(state) == {11, 12, 13})
    evaluate(page, "window.pads[1].buttons[7].value = 1")
    evaluate(page, "window.pads[0] = null")
    states(watcher).wait(lambda state: not servos_on(state))
    expect(page.said).to_contain_text(re.compile("the gamepad (is|was) disconnected"))
    for value in (0, 1):
        evaluate(page, f"window.pads[1].buttons[7].value = {value}")
    states(watcher).wait(lambda state: servos_on(state) == {11, 12, 13})


def test_a_page_that_gets_the_lease_moves_nothing_by_what_is_held_there(visitor: Visitor) -> None:
    first, second = visitor.open(script=PADS + WISHES), visitor.open(script=PADS + WISHES)
    first.get_lease()
    push_stick(0)(first)
    press_of_a_move(first)
    push_stick(0)(second)
    second.page.keyboard.down("w")
    second["lease-ask"].click()
    first["lease-hand-over"].click()
    expect(second["driver"]).to_have_text("you")
    second["stand"].click()
    expect_still(second)
    second.page.keyboard.up("w")
    second.page.keyboard.down("w")
    press_of_a_move(second)
    second.page.keyboard.up("w")


def test_a_short_press_of_b_is_an_emergency_stop(visitor: Visitor) -> None:
    """Some 20 ms are what a finger needs that hits the button and bounces off."""
    page = visitor.open(
        script=f"""{PADS}
window.stops = 0;
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {{
  if (text.includes('"stop_all"')) window.stops += 1;
  else send.call(this, text);
}};
"""
    )
    counted = page.page.evaluate(f"""async () => {{
      const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
      for (let press = 0; press < {PRESSES}; press += 1) {{
        const button = window.pads[press % 3].buttons[1];
        button.pressed = true;
        await pause({SHORT_MS});
        button.pressed = false;
        await pause(30 + (press % 17));
      }}
      return window.stops;
    }}""")
    assert counted == PRESSES


# ---- a thumb on the pad

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
