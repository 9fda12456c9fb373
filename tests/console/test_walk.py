"""Walking by the page: thumb, keys and gamepad on a real gateway, and what silences them."""

import math
import os
import signal
from typing import Final

import pytest
from playwright.sync_api import expect

from gateway.client import Client
from tests.console.browser import GAMEPAD, HIDE, Opened, Visitor
from tests.support.fixtures import client_fixture, console_fixture, gateway_fixture, patient, session_fixture

pytestmark = pytest.mark.browser

PHONES: Final = {"portrait": (320, 568), "landscape": (568, 320), "wide": (844, 390)}
TALL: Final = {"width": 390, "height": 844}


gateway = gateway_fixture(patient())
console = console_fixture()
session = session_fixture()
robot = client_fixture("watcher")


def drive(page: Opened) -> None:
    page["lease-acquire"].click()
    expect(page["driver"]).to_have_text("you")


def push(page: Opened, across: float, up: float) -> None:
    """Put the thumb on the pad, and push it so far."""
    box = page["pad"].bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + across * box["width"] / 2, y - up * box["height"] / 2)


def walks(page: Opened) -> None:
    """Push until it walks; where the page itself was held up by a busy machine, anew."""
    for _ in range(5):
        push(page, 0.1, 0.8)
        if _says(page, "It walks"):
            return
        page.page.mouse.up()
    raise AssertionError(page["said"].text_content())


def _says(page: Opened, words: str) -> bool:
    known = "document.getElementById('walk-known').textContent"
    page.page.wait_for_function(
        f"""(words) => {known}.includes(words)
        || (!document.querySelector('.stick[data-held="yes"]') && {known}.includes('stands'))""",
        arg=words,
    )
    return words in (page["walk-known"].text_content() or "")


def sit(page: Opened) -> None:
    page["sit"].click()
    expect(page.said).to_have_text("It sits, and its servos are stopped.")


@pytest.mark.parametrize("held", PHONES)
def test_on_a_small_phone_nothing_scrolls_to_walk_or_to_stop(visitor: Visitor, robot: Client, held: str) -> None:
    width, height = PHONES[held]
    page = visitor.open(viewport={"width": width, "height": height}, has_touch=True, is_mobile=True)
    drive(page)
    walks(page)
    needed = ("stop-all", "stop-known", "mode", "said", "picture", "stand", "sit", "pad", "turn", "gait-wave")
    for name in (*needed, "lower", "higher", "walk-known", "lease-release"):
        box = page[name].bounding_box()
        assert box is not None, name
        inside = (box["x"] >= 0, box["y"] >= 0, box["x"] + box["width"] <= width, box["y"] + box["height"] <= height)
        assert all(inside), (name, box)
        middle = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        hit = "([x, y]) => document.elementFromPoint(x, y).closest('[id]').id"
        assert name in ("picture", "gait-wave") or page.page.evaluate(hit, middle) == name
    for name in ("stop-all", "pad", "turn", "stand", "sit"):
        box = page[name].bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 44
    assert page.page.evaluate("document.documentElement.scrollHeight") <= height
    page.page.mouse.up()
    expect(page["walk-known"]).to_contain_text("It stands")
    page["stop-all"].tap()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    assert robot.state().mode == "estopped"


def test_keys_walk_and_turn_and_letting_go_stands(visitor: Visitor, robot: Client) -> None:
    page = visitor.open()
    page.page.keyboard.down("w")
    expect(page.said).to_have_text("Nothing moves: this page does not have the lease.")
    page.page.keyboard.up("w")
    drive(page)
    page["stand"].click()
    expect(page["walk-known"]).to_contain_text("It stands")
    for key in ("w", "q"):
        page.page.keyboard.down(key)
        expect(page["walk-known"]).to_contain_text("It walks")
        page.page.keyboard.up(key)
        expect(page["walk-known"]).to_contain_text("It stands")
    page["gait-wave"].check(force=True)
    page["lower"].click()
    expect(page["walk-known"]).to_contain_text("It stands, wave")
    assert robot.state().mode == "active"
    sit(page)
    assert robot.state().mode == "idle"


def test_a_gamepads_sticks_walk_and_its_b_button_is_stop_all(visitor: Visitor, robot: Client) -> None:
    page = visitor.open(script=GAMEPAD)
    drive(page)
    page.page.evaluate("pad.axes[1] = -1")
    expect(page["walk-known"]).to_contain_text("It walks")
    page.page.evaluate("pad.buttons[1].pressed = true")
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    assert robot.state().mode == "estopped"


def test_a_hidden_page_stands_and_goes_on_with_a_new_press_only(visitor: Visitor, robot: Client) -> None:
    page = visitor.open()
    drive(page)
    walks(page)
    page.page.evaluate(HIDE)
    expect(page.said).to_contain_text("It stands still: this page is hidden")
    assert robot.state().mode == "active"
    page.page.evaluate("Object.defineProperty(document, 'visibilityState', { value: 'visible', configurable: true })")
    expect(page["walk-known"]).to_contain_text("It stands")
    expect(page["pad"]).to_have_attribute("data-held", "no")
    page.page.mouse.up()
    walks(page)
    page.page.mouse.up()


def test_a_frozen_page_leaves_a_robot_that_stands_and_then_sits(visitor: Visitor, robot: Client) -> None:
    page = visitor.open()
    drive(page)
    walks(page)
    renderers = visitor.renderers()
    for renderer in renderers:
        os.kill(renderer, signal.SIGSTOP)
    try:
        while robot.state().mode != "idle":
            robot.state()
    finally:
        for renderer in renderers:
            os.kill(renderer, signal.SIGCONT)
    page.expect_live()
    expect(page["walk-known"]).to_have_text("Nothing walks by this page.")
    assert robot.state().mode == "idle"


def test_the_floor_goes_as_the_feet_that_stand_do(visitor: Visitor) -> None:
    """Four feet on the ground go back and turn about the body; two swing."""
    page = visitor.open()
    feet = {1: (0.2, 0.2, -0.1), 2: (0.2, -0.2, -0.1), 3: (-0.2, 0.2, -0.1), 4: (-0.2, -0.2, -0.1)}
    angle, back = math.radians(-2), -0.01

    def turned(x: float, y: float) -> tuple[float, float]:
        return math.cos(angle) * x - math.sin(angle) * y + back, math.sin(angle) * x + math.cos(angle) * y

    after = {leg: (*turned(x, y), z) for leg, (x, y, z) in feet.items()}
    air = {5: (0.0, 0.3, -0.06), 6: (0.0, -0.3, -0.07)}
    flown = {5: (0.05, 0.3, -0.06), 6: (0.05, -0.3, -0.07)}
    x, y, heading = page.module(
        "odometry",
        "(m, steps) => { const floor = new m.Odometry();"
        " for (const feet of steps) floor.update(new Map(feet)); return [floor.x, floor.y, floor.turned]; }",
        [list({**feet, **air}.items()), list({**after, **flown}.items())],
    )
    assert (x, y, heading) == pytest.approx((back, 0.0, angle), abs=1e-9)


def test_a_hands_slider_moves_a_servo_no_faster_than_60_degrees_a_second(visitor: Visitor) -> None:
    page = visitor.open(viewport=TALL)
    sent = page.module(
        "targets",
        "(m) => { const targets = new m.Targets(); targets.set(11, 100);"
        " return [90, 90, 90].map((commanded) => targets.approach(11, 3, commanded)); }",
    )
    assert sent == [93, 96, 99]
    page.show_joints()
    box = page["joint-1"].bounding_box()
    assert box is not None
    assert box["width"] > 300
    for leg in range(1, 7):
        expect(page[f"run-{leg}"]).not_to_be_checked()
