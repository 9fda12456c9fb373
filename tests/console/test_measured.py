"""On the page: a robot that measures, one that starts and stops as a whole, with a power board, and with physics."""

import json
import re
from pathlib import Path
from typing import Final

import pytest
from playwright.sync_api import Browser, expect

from gateway import geometry
from gateway.client import Client
from gateway.people.walking.planning import lying_deg
from gateway.people.walking.robot import Robot
from gateway.people.watching.dangers import UNCONFIRMED
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Battery, Telemetry
from tests.console.browser import CHANGES, Visitor
from tests.support.console_process import Console
from tests.support.fixtures import patient
from tests.support.gateway_process import Gateway
from tests.support.heard import servos_on, states
from tests.support.published import LEANING, measures

pytestmark = pytest.mark.browser

WHOLE: Final = f"""{CHANGES}
window.controller = {{ protocol: "elkapod-2025", alive: true, age_ms: 5 }};
window.change = (message) => {{
  if (message.type === "state") [message.whole, message.state.controller] = [true, window.controller];
}};
"""
"""Each state is that of a robot of which only the whole starts; the gateway behind it takes whole starts as well."""


def test_battery_tilt_temperature_and_the_feet_that_carry_are_shown_while_they_are_measured(
    visitor: Visitor, watcher: Client
) -> None:
    page = visitor.open()
    expect(page["measured"]).to_be_hidden()
    picture = page.page.locator("#picture > svg")
    with measures(watcher, LEANING):
        expect(page["battery"]).to_have_text("Battery 7.4 V, 80 %")
        expect(page["tilt-known"]).to_have_text("15°")
        expect(page["temperature"]).to_have_text("32 °C")
        expect(page["horizon-line"]).to_have_attribute("style", "transform: rotate(-15deg) translateY(0%);")
        for leg in LEGS:
            foot = picture.locator(".leg").nth(leg - 1).locator("circle").last
            expect(foot).to_have_class("carries" if leg in (1, 4, 5) else "hangs")
        expect(picture).to_have_attribute(
            "aria-label", re.compile(r"leg 1 \w+ and carries, leg 2 \w+ and carries noth")
        )
        assert page.violations() == {}
    expect(page["measured"]).to_be_hidden()
    expect(picture.locator(".carries, .hangs")).to_have_count(0)
    with measures(watcher, Telemetry(time=LEANING.time, age_ms=3.0, battery=Battery(voltage_v=6.4, percent=19.9))):
        expect(page["battery"]).to_have_text("Battery 6.4 V, 20 %, low")
        expect(page["battery"]).to_have_attribute("data-low", "yes")
        assert watcher.start_leg(1, 90, 90, 90).accepted
        expect(page["battery"]).to_have_text("Battery 6.4 V under load, 20 %, low")
        watcher.stop()
        expect(page["tilt"]).to_be_hidden()
        expect(page["temperature"]).to_be_hidden()


def test_one_hold_starts_all_six_legs_at_once_lying_and_a_stop_of_one_is_one_of_all(
    visitor: Visitor, watcher: Client
) -> None:
    page = visitor.open(script=WHOLE)
    page.get_lease()
    page.show_joints()
    expect(page["whole"]).to_have_text(
        "On this robot all six legs start together, lying, and a Stop of one leg stops all."
    )
    for name in ("hold-leg", "run-chooser", "run-all"):
        expect(page[name]).to_be_hidden()
    expect(page["stop-leg"]).to_have_text("Stop leg 1, and so all six")
    seen = states(watcher)
    page.page.keyboard.down("h")
    first = seen.wait(lambda state: servos_on(state) == set(SERVO_IDS))
    lying = lying_deg(Robot(geometry.load()))
    assert {servo.id: servo.angle_deg for leg in first.legs for servo in leg.servos} == pytest.approx(lying, abs=0.01)
    expect(page.said).to_have_text("Running legs 1, 2, 3, 4, 5 and 6 while you hold.")
    page["stop-leg"].click()
    expect(page.said).to_have_text("Stops sent to all six legs.")
    states(watcher).wait(lambda state: not servos_on(state))
    page.page.keyboard.up("h")
    page["cal"].locator("summary").click()
    expect(page["cal-whole"]).to_be_visible()
    expect(page["cal-start"]).to_be_disabled()
    page.page.evaluate("window.controller.alive = false")
    expect(page["measured"]).to_have_text("Controller silent", use_inner_text=True)


# ---- with a power board: a Stop that the board does not confirm

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


def test_a_stop_that_the_board_does_not_confirm_is_red_on_both_pages_and_one_that_it_confirms_has_its_time(
    visitor: Visitor,
) -> None:
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
    assert page.violations() == {}
    page.page.evaluate("(said) => (window.board = said)", FED)
    expect(page["stop"]).to_have_attribute("data-tone", "stopped")
    page.go_to_button()
    page["button"].click()
    expect(page["word"]).to_have_text("STOPPED")
    page.page.evaluate("(said) => (window.board = said)", NOT_CONFIRMED)
    expect(page["word"]).to_have_text("CUT POWER")
    expect(page["known"]).to_have_text(UNCONFIRMED)
    expect(page.page.locator("body")).to_have_attribute("data-tone", "unconfirmed")
    page["leave"].click()


# ---- simulated with physics: where its body is, and how somebody sets it upright

PATIENT: Final = patient(10_000)
"""A browser that draws on the processor leaves little of it to others."""
STEEP: Final = "--sim=physics --terrain slope:30 --friction 3 --mass-kg 1 --servo-torque-nm 20"


def both_sides(client: Client, legs: tuple[int, ...], second_deg: float, third_deg: float, verb: str) -> None:
    """Do the same to left and right legs, whose servos are mirrored."""
    angles = {leg: (90, second_deg, third_deg) if leg % 2 else (90, 180 - second_deg, 180 - third_deg) for leg in legs}
    assert getattr(client, verb)(angles).accepted


@pytest.mark.nightly
def test_a_fallen_robot_is_set_upright(browser: Browser, tmp_path: Path) -> None:
    """On a slope, against which its height and its leaning count."""
    with (
        Gateway(tmp_path, PATIENT, options=STEEP.split()) as gateway,
        Console(tmp_path, "--connect", gateway.endpoint) as console,
        Visitor(browser, console.url, console.sign_in()) as visitor,
        gateway.client() as client,
    ):
        page = visitor.open(webgl=True)
        for view in ("view-above", "view-solid"):  # who chooses them by hand gets them, however slow they are
            page[view].check(force=True)
        expect(page["sim-known"]).to_have_text(re.compile("^[5-7] cm high, leaning by [01]°"))
        both_sides(client, (1, 2, 3, 4, 5, 6), 150, 110, "start_legs")
        both_sides(client, (1, 2, 3, 4), 0, 20, "set_legs")  # which push it over backwards
        expect(page["sim-known"]).to_have_text(re.compile("on its back"))
        page.page.screenshot(path=tmp_path / "fallen.png")
        assert client.stop().accepted
        page["set-upright"].click()
        expect(page["said"]).to_have_text("It stands on its feet again.")
