"""What the console's page shows and does, on a real gateway with a simulated controller."""

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, expect

from gateway.client import Client
from tests.console.browser import PHONE, Visitor
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway

pytestmark = pytest.mark.browser


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


def test_a_reset_asks_first_and_stop_all_answers_no(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open()
    page["stop-all"].click()
    page["reset"].click()
    expect(page["question-no"]).to_be_focused()
    page["stop-all"].click()  # within reach beside the question
    expect(page["question"]).not_to_be_visible()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    page["reset"].click()
    page["question-no"].press("Enter")
    assert watcher.state().mode == "estopped"
    page["reset"].click()
    page["question-yes"].click()
    expect(page.said).to_contain_text("Nothing moves until it is started again")
    assert watcher.state().mode == "idle"


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
    browser: Browser, gateway: Gateway, watcher: Client, tmp_path: Path
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
        assert watcher.state().mode == "idle"
        other = visitor.open()
        other.go_to_button()
        expect(other["word"]).to_have_text("NO BUTTON")
        other["button"].click()
        expect(other["word"]).to_have_text("NO BUTTON")
        assert console.run("--sign-out").returncode == 0
        expect(page["stop-known"]).to_contain_text("NOT CONNECTED: use the switch")
        expect(page["stop-known"]).to_contain_text("You are not signed in")
