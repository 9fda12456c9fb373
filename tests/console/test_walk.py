"""Walking by the page: thumb, keys and gamepad on a real gateway, and what silences them."""

import re
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Final

import pytest
from playwright.sync_api import expect

from gateway.client import Client
from tests.console.browser import GAMEPAD, WISHES, Opened, Visitor, expect_still, push, walks
from tests.support.child import frozen
from tests.support.fixtures import console_fixture, gateway_fixture, patient, session_fixture
from tests.support.heard import states

pytestmark = pytest.mark.browser

gateway = gateway_fixture(patient())
console = console_fixture()
session = session_fixture()


CHANGES_ONLY: Final = """
let before = "";
navigator.getGamepads = () => {
  window.looks += 1;
  const now = JSON.stringify([pad.axes, pad.buttons]);
  if (now !== before) window.pad.timestamp += 1;
  before = now;
  return [window.pad];
};
"""
BAND: Final = """
window.band = [];
const look = () => {
  const band = document.getElementById("stop-known");
  if (band?.checkVisibility({ visibilityProperty: true })) window.band.push(band.textContent.trim());
  requestAnimationFrame(look);
};
requestAnimationFrame(look);
"""
"""Keeps what the band next to STOP ALL shows with each frame, from the first one."""


def sit(page: Opened) -> None:
    page["sit"].click()
    expect(page.said).to_have_text("It sits, and its servos are stopped.")


def press(key: str, page: Opened) -> None:
    page.page.keyboard.up(key)
    page.page.keyboard.down(key)


def test_keys_walk_and_turn_and_letting_go_stands(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open()
    page.page.keyboard.down("w")
    expect(page.said).to_have_text("Nothing moves: this page does not have the lease; press Drive.")
    page.page.keyboard.up("w")
    page.get_lease()
    page["stand"].click()
    expect(page.said).to_have_text("It stands.")
    for key in ("w", "q"):
        walks(page, partial(press, key))
        page.page.keyboard.up(key)
        expect(page["walk-known"]).to_contain_text("It stands")
    page["gait-wave"].check(force=True)
    page["lower"].click()
    expect(page["walk-known"]).to_contain_text("It stands, wave")
    watcher.stop(3)
    expect(page["walk-known"]).to_contain_text("Leg 3 is stopped, and the others stand still, wave")
    expect(page.said).to_have_text("watcher stopped leg 3.")
    page["stand"].click()
    expect(page["walk-known"]).to_contain_text("It stands, wave")
    assert watcher.state().mode == "active"
    sit(page)
    assert watcher.state().mode == "idle"


@pytest.mark.parametrize(
    "let_go",
    [
        lambda page: page.devtools().send("Input.dispatchKeyEvent", {"type": "keyUp", "code": "KeyE", "key": "€"}),
        lambda page: page.page.keyboard.press("Meta"),
    ],
    ids=["with another letter", "with Command"],
)
def test_a_key_is_let_go_whatever_else_is_pressed(visitor: Visitor, let_go: Callable[[Opened], None]) -> None:
    """Also the key H (keys.js). macOS reports no release of a key that is let go while Command is held."""
    page = visitor.open()
    page.get_lease()
    walks(page, partial(press, "e"))
    let_go(page)
    expect(page["walk-known"]).to_contain_text("It stands")


def push_stick(page: Opened) -> None:
    for deflection in (0, -1):
        page.page.evaluate("(deflection) => { pad.axes[1] = deflection; window.looks = 0; }", deflection)
        page.page.wait_for_function("() => window.looks > 2")


@pytest.mark.nightly
def test_a_stick_that_no_longer_counts_moves_nothing_until_it_was_in_the_middle(visitor: Visitor) -> None:
    page = visitor.open(script=GAMEPAD + WISHES)
    page.get_lease()
    walks(page, push_stick)
    page.page.evaluate("window.muted = true")
    expect(page.said).to_have_text("It stands still: the console received nothing of this page for a moment.")
    page.page.evaluate("window.muted = false")
    expect_still(page)
    walks(page, push_stick)
    expect(page.said).to_contain_text("It stands still: a stick was pushed for 10 s", timeout=12_000)
    page.page.evaluate("pad.buttons[4].pressed = true")
    walks(page, push_stick)


def test_a_gamepad_out_of_reach_counts_as_let_go_and_each_ones_b_button_is_stop_all(
    visitor: Visitor, watcher: Client
) -> None:
    """A browser shows the last values of one that is out of reach, for ever: its stick seems to be held."""
    page = visitor.open(script=GAMEPAD + WISHES)
    expect(page["gamepad-unusable"]).to_contain_text("Unknown stick")
    page.get_lease()
    walks(page, push_stick)
    page.page.evaluate("window.frozen = true")
    expect(page.said).to_have_text("It stands still: the gamepad sent nothing for 0.5 s.", timeout=3000)
    expect(page["walk-known"]).to_contain_text("It stands")
    page.page.evaluate("window.frozen = false")
    expect_still(page)
    walks(page, push_stick)
    for pad in (2, 0):  # the one before is out of reach by then: its button seems to be held
        page.page.evaluate(f"pads[{pad}].buttons[1].pressed = true")
        expect(page["stop-known"]).to_contain_text("6 Stops written within")
        assert watcher.state().mode == "estopped"
        page["reset"].click()
        page["question-yes"].click()
        expect(page["stop-line"]).to_have_text("Escape or space, at any time")


@pytest.mark.parametrize("shoulder", [False, True])
def test_a_gamepad_that_reports_changes_only_holds_a_stick_at_its_end_with_a_shoulder_button(
    visitor: Visitor, *, shoulder: bool
) -> None:
    """Its clock goes on only with its values, so it is silent while a stick is at its end."""
    page = visitor.open(script=GAMEPAD + CHANGES_ONLY + WISHES)
    page.get_lease()
    page.page.evaluate("(pressed) => { pad.buttons[4].pressed = pressed; }", shoulder)
    walks(page, push_stick)
    if not shoulder:
        remedy = "to hold a stick at its end, hold a shoulder button too"
        expect(page.said).to_have_text(f"It stands still: the gamepad sent nothing for 0.5 s; {remedy}.")
        expect_still(page)
        return
    page.page.evaluate("window.wishes = []")
    page.page.wait_for_function("() => window.wishes.length > 60")  # six times as long
    assert page.page.evaluate("window.wishes.every((wish) => wish.forward_m_s)")
    expect(page.said).to_have_text("It stands still: the gamepad sent nothing for 10 s.")  # it may be out of reach


LAYOUTS: Final = {"Russian": "ц", "Greek": "ς", "AZERTY": "z", "Arabic": "ص"}
"""What the key at the place of W types."""


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_key_at_the_place_of_w_walks_whatever_it_types(layout: str, visitor: Visitor) -> None:
    page = visitor.open()
    page.get_lease()
    devtools = page.devtools()

    def key(kind: str) -> None:
        devtools.send("Input.dispatchKeyEvent", {"type": kind, "key": LAYOUTS[layout], "code": "KeyW"})

    def press_anew(_: Opened) -> None:
        key("keyUp")
        key("keyDown")

    walks(page, press_anew)
    key("keyUp")
    expect(page["walk-known"]).to_contain_text("It stands")


def test_a_page_that_is_loaded_anew_drives_on_and_stands_until_something_is_pressed(
    visitor: Visitor, watcher: Client
) -> None:
    """On a phone a reload is one pull with the thumb. A page of another browser gets nothing by it."""
    page = visitor.open(script=WISHES + BAND)
    page.get_lease()
    walks(page, push)
    page.page.reload()
    expect(page["driver"]).to_have_text("you", timeout=2000)
    assert not [line for line in page.page.evaluate("window.band") if "NOT CONNECTED" in line]
    expect(page["walk-known"]).to_contain_text("It stands")
    page.page.wait_for_function("() => window.wishes.length > 120")  # longer than a silent page's robot stands
    assert not page.page.evaluate("window.wishes.some((wish) => wish.forward_m_s)")
    expect(page["walk-known"]).to_contain_text("It stands")
    assert watcher.state().mode == "active"
    walks(page, push)
    page.page.mouse.up()
    sit(page)


def test_a_hidden_page_stands_and_goes_on_with_a_new_press_only(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open()
    page.get_lease()
    push(page)
    expect(page["walk-known"]).to_contain_text("It moves to another posture")
    page.hide()
    expect(page.said).to_have_text("What is held no longer counts: this page is hidden.")  # and it rises on
    page.show()
    walks(page, push)
    page.hide()
    expect(page.said).to_contain_text("It stands still: this page is hidden")
    assert watcher.state().mode == "active"
    page.show()
    expect(page["walk-known"]).to_contain_text("It stands")
    expect(page["pad"]).to_have_attribute("data-held", "no")
    page.page.mouse.up()
    walks(page, push)
    page.page.mouse.up()


def test_a_frozen_page_leaves_a_robot_that_stands_and_goes_on_with_a_new_press_only(
    visitor: Visitor, watcher: Client
) -> None:
    page = visitor.open()
    page.get_lease()
    walks(page, push)
    with frozen(*visitor.renderers()):
        newest: deque[list[float | None]] = deque(maxlen=6)
        for state in states(watcher).each():  # until for half a second no servo is commanded anywhere else
            newest.append([servo.angle_deg for leg in state.legs for servo in leg.servos])
            if len(newest) == newest.maxlen and all(each == newest[0] for each in newest):
                break
    expect(page.said).to_contain_text(
        re.compile("It stands still: (this page was frozen|the console received nothing)")
    )
    assert watcher.state().mode == "active"
    page.expect_live()
    expect(page["walk-known"]).to_contain_text("It stands")
    page.page.mouse.up()
    walks(page, push)
