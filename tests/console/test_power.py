"""A robot with a power board, on the page: a Stop that the board does not confirm, and what each servo draws."""

import json
from typing import Any, Final

import pytest
from playwright.sync_api import expect

from gateway.client import Client
from gateway.people.client.dangers import UNCONFIRMED
from schemas.telemetry import Kind, ServoTelemetry, Supply, Telemetry
from tests.console.browser import Visitor
from tests.console.test_measured import COVERED, SIZES, expect_no_serious_violation, report
from tests.support.fixtures import client_fixture
from tests.support.measuring import measures
from tests.support.published import WALL

pytestmark = pytest.mark.browser

FED: Final = {"power": "18 fed", "unconfirmed": ""}
NOT_CONFIRMED: Final = {"power": "off not confirmed, 18 fed", "unconfirmed": UNCONFIRMED}
BOARD: Final = """
window.board = %s;
const listen = WebSocket.prototype.addEventListener;
WebSocket.prototype.addEventListener = function (name, heard, ...more) {
  listen.call(this, name, name !== "message" ? heard : (event) => {
    const message = JSON.parse(event.data);
    if (message.type === "state") Object.assign(message, window.board);
    if (message.type === "stop" && message.answered) message.power = ", power confirmed off after 34 ms";
    heard({ data: JSON.stringify(message) });
  }, ...more);
};
"""
"""What the console says of a power board, while the gateway behind it has none."""
DRAWN: Final = Telemetry(
    time=WALL,
    age_ms=3.0,
    servos={
        "11": ServoTelemetry(supplied=True, current_a=0.25),
        "12": ServoTelemetry(supplied=True, current_a=2.5),
        "13": ServoTelemetry(supplied=False),
    },
    supply=Supply(voltage_v=7.31, current_a=2.75),
)

robot = client_fixture("watcher")


def board(**said: str) -> str:
    return BOARD % json.dumps(said)


def test_a_stop_that_the_board_does_not_confirm_is_red_and_one_that_it_confirms_has_its_time(visitor: Visitor) -> None:
    page = visitor.open(script=board(**FED))
    page["stop-all"].click()
    expect(page["stop-known"]).to_contain_text("6 Stops written within")
    expect(page["stop-known"]).to_contain_text("ms, power confirmed off after 34 ms")
    expect(page["stop"]).to_have_attribute("data-tone", "good")
    page.page.evaluate("(said) => (window.board = said)", NOT_CONFIRMED)
    expect(page["stop-known"]).to_have_text(UNCONFIRMED)
    expect(page["stop"]).to_have_attribute("data-tone", "bad")
    expect(page["stop-aloud"]).to_have_text(UNCONFIRMED)
    expect(page["power"]).to_have_attribute("data-bad", "yes")
    expect_no_serious_violation(page)
    page.page.evaluate("(said) => (window.board = said)", FED)
    expect(page["stop"]).to_have_attribute("data-tone", "good")


def test_the_button_of_a_robot_whose_stop_is_not_confirmed_is_red(visitor: Visitor) -> None:
    page = visitor.open(script=board(**FED))
    page.page.goto(f"{page.page.url.rstrip('/')}/button")
    page["button"].click()
    expect(page["word"]).to_have_text("STOP")
    page.page.evaluate("(said) => (window.board = said)", NOT_CONFIRMED)
    expect(page["word"]).to_have_text("CUT POWER")
    expect(page["known"]).to_have_text(UNCONFIRMED)
    expect(page.page.locator("body")).to_have_attribute("data-tone", "unconfirmed")
    page["leave"].click()


@pytest.mark.nightly
def test_what_each_servo_draws_is_a_bar_and_the_strip_stays_on_the_picture(visitor: Visitor, robot: Client) -> None:
    width, height = SIZES[0]
    page = visitor.open(
        script=board(**NOT_CONFIRMED), viewport={"width": width, "height": height}, has_touch=True, is_mobile=True
    )
    expect(page["draws"]).to_be_hidden()
    with measures(robot, DRAWN):
        expect(page["supply"]).to_have_text(", 7.3 V")
        for width, height in SIZES:
            page.page.set_viewport_size({"width": width, "height": height})
            assert page.page.evaluate(COVERED) == [], (width, height)
        page.show_rest()
        expect(page["draws"]).to_have_text("Servo 12 draws most: 2.50 A of 2.75 A. A full bar is 2.50 A.")
        widths: Any = page.page.evaluate(
            "[...document.querySelectorAll('#leg-row-1 .track')].slice(0, 3)"
            ".map((track) => !track.hidden && track.firstChild.style.width)"
        )
        assert widths == ["10%", "100%", False]
    expect(page["draws"]).to_be_hidden()


@pytest.mark.nightly
def test_an_event_of_the_board_is_bad_and_said_in_plain_words(visitor: Visitor, robot: Client) -> None:
    page = visitor.open()
    report(robot, Kind.POWER_UNCONFIRMED)
    expect(page.said).to_contain_text("The power board does not confirm that servos are off")
    expect(page["events"].locator("li").first).to_have_attribute("data-tone", "bad")
    expect(page["stop-known"]).not_to_have_text(UNCONFIRMED)  # this robot has no board, as its next state shows
