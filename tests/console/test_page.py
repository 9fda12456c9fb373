"""What the console's page shows and does, on a real gateway with a simulated controller."""

import os
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, expect

from schemas.robot import LEGS
from tests.console.browser import PHONE, Visitor
from tests.support.child import Child
from tests.support.console_process import Console
from tests.support.gateway_process import COMMAND, Gateway

pytestmark = pytest.mark.browser


@pytest.mark.nightly
def test_eighteen_servos_are_seen_in_three_dimensions_and_in_words(visitor: Visitor, gateway: Gateway) -> None:
    page = visitor.open(webgl=True)
    page.insist_on_three_dimensions()
    command = [*COMMAND, "send", "leg", "3", "start", "91", "46", "121", "--hold", "60", "--connect", gateway.endpoint]
    with Child(command, os.environ):
        page.expect_status(3, "runs")
        expect(page["leg-row-3"]).to_contain_text("91.0°46.0°121.0°")
        expect(page.page.locator(".label", has_text="3 ▶")).to_have_attribute("data-status", "runs")
    page.expect_status(3, "stopped by the watchdog")
    page.expect_status(2, "rests")
    for number in ("number-lag", "number-latency"):
        expect(page[number]).to_have_text(re.compile(r"^[\d.]+ · [\d.]+ · [\d.]+ ms$"))
    expect(page.page.locator("#picture canvas")).to_have_attribute(
        "aria-label", re.compile("leg 3 stopped by the watch")
    )
    expect(page["events"].locator("li", has_text="no command for leg 3 in 2000 ms")).to_have_count(1)


def test_stop_all_stops_and_says_what_is_known_and_who_else_stopped(visitor: Visitor, gateway: Gateway) -> None:
    page = visitor.open()

    def tap() -> None:
        page["stop-all"].click()

    def escape() -> None:
        page.show_joints()
        page["joint-1"].focus()
        page.page.keyboard.press("Escape")

    def space_with_option() -> None:
        pressed = {"type": "keyDown", "code": "Space", "key": "\u00a0"}
        page.devtools().send("Input.dispatchKeyEvent", pressed)

    with gateway.client(source="bert") as robot:
        for press in (tap, escape, space_with_option):
            before = robot.state().estop
            press()
            expect(page["stop-known"]).to_contain_text("6 Stops written within")
            expect(page["mode"]).to_have_text("stopped, latched")
            assert robot.state().mode == "estopped"
            assert robot.state().estop > before
            assert robot.reset().accepted
            expect(page["stop-line"]).to_have_text("Escape or space, at any time")
        robot.estop()
        expect(page["stop-line"]).to_have_text(re.compile(r"STOPPED by bert, \d\d:\d\d"))


def test_a_reset_asks_first_and_stop_all_answers_no(visitor: Visitor, gateway: Gateway) -> None:
    page = visitor.open()
    page["stop-all"].click()
    page["reset"].click()
    expect(page["question-no"]).to_be_focused()
    page["stop-all"].click()  # within reach beside the question
    expect(page["question"]).not_to_be_visible()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    page["reset"].click()
    page["question-no"].press("Enter")
    with gateway.client() as robot:
        assert robot.state().mode == "estopped"
        page["reset"].click()
        page["question-yes"].click()
        expect(page.said).to_contain_text("Nothing moves until it is started again")
        assert robot.state().mode == "idle"


def test_a_phone_has_all_of_it(visitor: Visitor) -> None:
    page, size = visitor.open(**PHONE), PHONE["viewport"]
    assert page.page.evaluate("document.documentElement.scrollWidth") <= size["width"]
    box = page["stop-all"].bounding_box()
    assert box is not None
    assert (box["height"] >= 44, box["y"] + box["height"] <= size["height"]) == (True, True)
    page.show_joints()
    box = page["joint-1"].bounding_box()
    assert box is not None
    assert box["width"] > size["width"] * 0.75
    for leg in LEGS:
        expect(page[f"run-{leg}"]).not_to_be_checked()
    page["events"].scroll_into_view_if_needed()
    page["stop-all"].tap()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")


@pytest.mark.nightly
@pytest.mark.parametrize("layout", [{}, PHONE], ids=["wide", "held"])
def test_axe_finds_nothing(visitor: Visitor, layout: dict[str, Any]) -> None:
    page = visitor.open(**layout)
    assert page.violations() == {}
    page.get_lease()
    assert page.violations() == {}
    page.show_rest()
    assert page.violations() == {}
    page["stop-all"].click()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    assert page.violations() == {}
    page["reset"].click()
    expect(page["question"]).to_be_visible()
    assert page.violations() == {}


def test_an_observer_is_sent_to_the_switch_and_whose_session_was_ended_is_told_how_to_go_on(
    browser: Browser, gateway: Gateway, tmp_path: Path
) -> None:
    with (
        Console(tmp_path, "--connect", gateway.endpoint, "--role", "observer") as console,
        Visitor(browser, console.url, console.sign_in()) as visitor,
    ):
        page = visitor.open()
        expect(page["stop-line"]).to_have_text("View only: use the power switch")
        expect(page["stop-all"]).to_be_disabled()
        expect(page["controls"]).not_to_be_visible()
        expect(page["walk-controls"]).not_to_be_visible()
        page.page.keyboard.press("Escape")
        page.page.keyboard.press("h")
        page.expect_live()
        with gateway.client() as robot:
            assert robot.state().mode == "idle"
        assert console.run("--sign-out").returncode == 0
        expect(page["stop-known"]).to_contain_text("NOT CONNECTED: use the switch")
        expect(page["stop-known"]).to_contain_text("You are not signed in")
