"""The console's /button: a page that is a stop button."""

from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, expect

from gateway.client import Client
from schemas.gateway_state import GatewayState
from schemas.words import Kind, Mode
from tests.console.browser import COUNTS, Opened, Visitor
from tests.support.child import frozen
from tests.support.console_process import Console
from tests.support.gateway_process import Gateway
from tests.support.heard import events, states

pytestmark = pytest.mark.browser

LANDSCAPE: dict[str, Any] = {"viewport": {"width": 568, "height": 320}, "has_touch": True, "is_mobile": True}
HELD_BACK = """
window.heldBackMs = {};
WebSocket.prototype.send = ((send) => function (text) {
  const heldBackMs = Object.entries(window.heldBackMs).find(([verb]) => text.includes(`"do":"${verb}"`))?.[1];
  if (heldBackMs) setTimeout(() => send.call(this, text), heldBackMs);
  else send.call(this, text);
})(WebSocket.prototype.send);
"""
"""Somebody on the way delays what the page sends."""


def alive(watcher: Client, count: int) -> GatewayState:
    return states(watcher).wait(lambda state: state.buttons.alive == count, timeout_s=30)


def watching(visitor: Visitor, watcher: Client, script: str = "", **options: Any) -> Opened:
    """Return a page that checks in."""
    page = visitor.open(script=script, **options)
    page.go_to_button()
    expect(page["word"]).to_have_text("TAP TO WATCH")
    page["button"].click()
    expect(page["word"]).to_have_text("STOP")
    assert "/page " in alive(watcher, 1).buttons.names[0]
    return page


def test_a_tap_anywhere_stops(visitor: Visitor, watcher: Client) -> None:
    page = watching(visitor, watcher, COUNTS, **LANDSCAPE)
    page.page.wait_for_function("() => document.fullscreenElement !== null && window.wakes === 1")
    start = visitor.open()
    expect(start["buttons"]).to_have_text("1 alive")
    page["button"].tap()
    expect(page["known"]).to_have_text("6 Stops written")
    expect(page["word"]).to_have_text("STOPPED")
    state = watcher.state()
    assert state.mode == Mode.ESTOPPED
    assert state.estop_source == state.buttons.names[0], "by its own name, and not the console's"
    assert watcher.reset().accepted
    expect(page["word"]).to_have_text("STOP")
    page["leave"].click()
    alive(watcher, 0)


@pytest.mark.parametrize("key", ["Escape", "Space"])
def test_on_a_laptop_the_keys_of_stop_all_stop_wherever_the_focus_is(
    visitor: Visitor, watcher: Client, key: str
) -> None:
    page = watching(visitor, watcher)
    page["leave"].focus()
    page.page.keyboard.press(key)
    expect(page["known"]).to_have_text("6 Stops written")
    assert watcher.state().mode == Mode.ESTOPPED


def test_where_nothing_is_heard_it_says_so_and_shakes_and_a_tap_waits_for_the_connection(
    visitor: Visitor, watcher: Client, console: Console
) -> None:
    page = watching(visitor, watcher, COUNTS, **LANDSCAPE)
    with frozen(console.child.pid):
        expect(page["word"]).to_have_text("NO SIGNAL")
        expect(page["known"]).to_contain_text("use the switch")
        assert page.page.evaluate("window.shakes.length") > 0
        assert page.page.evaluate("document.body.scrollHeight <= innerHeight"), "all of it is seen"
        page["button"].tap()
        expect(page["known"]).to_have_text("STOPPING …")
    expect(page["known"]).to_have_text("6 Stops written")
    expect(page["word"]).to_have_text("STOPPED")


def test_a_page_of_a_button_stops_and_drives_nothing(
    browser: Browser, gateway: Gateway, watcher: Client, tmp_path: Path
) -> None:
    with (
        Console(tmp_path, "--connect", gateway.endpoint, "--role", "button") as console,
        Visitor(browser, console.url, console.sign_in()) as visitor,
    ):
        page = watching(visitor, watcher)
        page["button"].click()
        expect(page["word"]).to_have_text("STOPPED")
        page["leave"].click()
        expect(page["only-looks"]).to_be_visible()
        expect(page["lease-acquire"]).to_be_hidden()
        expect(page["reset"]).to_be_hidden()
        assert watcher.reset().accepted
        page["stop-all"].click()
        expect(page["stop-known"]).to_contain_text("6 Stops written within")
        assert watcher.reset().accepted


def test_a_page_that_is_hidden_is_silent_and_checks_in_again_when_it_is_seen(visitor: Visitor, watcher: Client) -> None:
    """A phone that is locked, and unlocked."""
    heard = events(watcher)
    page = watching(visitor, watcher, COUNTS)
    page.hide()
    heard.wait(lambda event: event.kind == Kind.BUTTON_SILENT)
    expect(page["word"]).to_have_text("NO SIGNAL")
    page.show()
    heard.wait(lambda event: event.kind == Kind.BUTTON_RETURNED)
    expect(page["word"]).to_have_text("STOP")
    assert page.page.evaluate("window.wakes") == 2, "the browser let go of the screen when it was hidden"


def test_answers_that_come_late_are_seen_and_a_registration_that_was_held_back_does_not_count(
    visitor: Visitor, watcher: Client
) -> None:
    page = watching(visitor, watcher, HELD_BACK)
    page.page.evaluate("window.heldBackMs = { alive: 400 }")
    expect(page["known"]).to_contain_text("its answers come late: after 0.4 s")
    expect(page["word"]).to_have_text("STOP")
    page["leave"].click()
    page = visitor.open(script=HELD_BACK)
    page.go_to_button()
    page.page.evaluate("window.heldBackMs = { register: 600 }")
    page["button"].click()
    expect(page["known"]).to_contain_text("to register took 0.6 s, which is too long")
    expect(page["word"]).to_have_text("NO SIGNAL")
    page["button"].click()
    expect(page["known"]).to_have_text("6 Stops written")
    assert watcher.state().mode == Mode.ESTOPPED


def test_a_page_that_is_frozen_is_silent_and_the_console_says_nothing_for_it(visitor: Visitor, watcher: Client) -> None:
    page = watching(visitor, watcher)
    with frozen(*visitor.renderers()):
        alive(watcher, 0)
    alive(watcher, 1)
    expect(page["word"]).to_have_text("STOP")
