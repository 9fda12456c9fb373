"""A robot with a power board, on the page: a Stop that the board does not confirm, and what each servo draws."""

import json
from typing import Final

import pytest
from playwright.sync_api import expect

from gateway.people.client.dangers import UNCONFIRMED
from tests.console.browser import CHANGES, Visitor
from tests.console.test_measured import expect_no_serious_violation
from tests.support.fixtures import client_fixture

pytestmark = pytest.mark.browser

FED: Final = {"power": "18 fed", "unconfirmed": ""}
NOT_CONFIRMED: Final = {"power": "off not confirmed, 18 fed", "unconfirmed": UNCONFIRMED}
BOARD: Final = """
window.board = %s;
window.change = (message) => {
  if (message.type === "state") Object.assign(message, window.board);
  if (message.type === "stop" && message.answered) message.power = ", power confirmed off after 34 ms";
};
"""
"""What the console says of a power board, while the gateway behind it has none."""

robot = client_fixture("watcher")


def test_a_stop_that_the_board_does_not_confirm_is_red_and_one_that_it_confirms_has_its_time(visitor: Visitor) -> None:
    page = visitor.open(script=CHANGES + BOARD % json.dumps(FED))
    page["stop-all"].click()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    expect(page["stop-known"]).to_contain_text("ms, power confirmed off after 34 ms")
    expect(page["stop"]).to_have_attribute("data-tone", "stopped")
    page.page.evaluate("(said) => (window.board = said)", NOT_CONFIRMED)
    expect(page["stop-line"]).to_have_text(UNCONFIRMED)
    expect(page["stop"]).to_have_attribute("data-tone", "bad")
    expect(page["stop-aloud"]).to_have_text(UNCONFIRMED)
    expect(page["power"]).to_have_attribute("data-bad", "yes")
    expect_no_serious_violation(page)
    page.page.evaluate("(said) => (window.board = said)", FED)
    expect(page["stop"]).to_have_attribute("data-tone", "stopped")


def test_the_button_of_a_robot_whose_stop_is_not_confirmed_is_red(visitor: Visitor) -> None:
    page = visitor.open(script=CHANGES + BOARD % json.dumps(FED))
    page.go_to_button()
    page["button"].click()
    expect(page["word"]).to_have_text("STOP")
    page.page.evaluate("(said) => (window.board = said)", NOT_CONFIRMED)
    expect(page["word"]).to_have_text("CUT POWER")
    expect(page["known"]).to_have_text(UNCONFIRMED)
    expect(page.page.locator("body")).to_have_attribute("data-tone", "unconfirmed")
    page["leave"].click()
