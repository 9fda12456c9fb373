"""A robot that measures, on the page; and one of which only the whole starts and stops."""

import re
from datetime import timedelta
from typing import Any, Final

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from gateway import geometry
from gateway.client import Client
from gateway.people.console.app import lying_deg
from schemas import keys
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Battery, Event, GatewayState, Kind, Telemetry
from tests.console.browser import Opened, Visitor
from tests.support.fixtures import client_fixture
from tests.support.heard import states
from tests.support.measuring import LEANING, measures

pytestmark = pytest.mark.browser

WHOLE: Final = """
window.controller = { protocol: "elkapod-2025", alive: true, age_ms: 5 };
const listen = WebSocket.prototype.addEventListener;
WebSocket.prototype.addEventListener = function (name, heard, ...more) {
  listen.call(this, name, name !== "message" ? heard : (event) => {
    const message = JSON.parse(event.data);
    if (message.type === "state") [message.whole, message.state.controller] = [true, window.controller];
    heard({ data: JSON.stringify(message) });
  }, ...more);
};
"""
"""Each state is that of a robot of which only the whole starts; the gateway behind it takes whole starts as well."""
COVERED: Final = """() => {
  const box = (each) => each.getBoundingClientRect();
  const [strip, picture] = ["measured", "picture"].map((id) => box(document.getElementById(id)));
  const beyond = strip.left < picture.left || strip.right > picture.right || strip.bottom > picture.bottom;
  const over = [...document.querySelectorAll(".see .head :is(label, button)")].filter((each) => {
    const { left, right, top, bottom } = box(each);
    const crosses = left < strip.right && right > strip.left && top < strip.bottom && bottom > strip.top;
    return each.checkVisibility() && crosses;
  });
  return [...(beyond ? ["the picture's edge"] : []), ...over.map((each) => each.textContent)];
}"""
"""What the strip is under."""
SIZES: Final = ((320, 568), (568, 320), (360, 640), (640, 360), (390, 844), (844, 390))

robot = client_fixture("watcher")


def report(client: Client, kind: Kind, *, ago_s: float = 0.0) -> None:
    """Publish an event, as the gateway would."""
    at = client.state().time - timedelta(seconds=ago_s)
    event = Event(time=at, kind=kind, source=None, key=None, reason=None, detail=f"{kind} {ago_s} s ago")
    client.session.put(keys.EVENT, event.model_dump_json())


def test_battery_tilt_temperature_and_the_feet_that_carry_are_shown_while_they_are_measured(
    visitor: Visitor, robot: Client
) -> None:
    page = visitor.open()
    expect(page["measured"]).to_be_hidden()
    picture = page.page.locator("#picture > svg")
    with measures(robot, LEANING):
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
        expect_no_serious_violation(page)
    expect(page["measured"]).to_be_hidden()
    expect(picture.locator(".carries, .hangs")).to_have_count(0)
    with measures(robot, Telemetry(time=LEANING.time, age_ms=3.0, battery=Battery(voltage_v=6.4, percent=19.9))):
        expect(page["battery"]).to_have_text("Battery 6.4 V, 20 %, low")
        expect(page["battery"]).to_have_attribute("data-low", "yes")
        expect(page["tilt"]).to_be_hidden()
        expect(page["temperature"]).to_be_hidden()


def expect_no_serious_violation(page: Opened) -> None:
    for scheme in ("dark", "light"):  # as it was
        page.page.emulate_media(color_scheme=scheme)
        found = Axe().run(page.page).response["violations"]
        serious = [each for each in found if each["impact"] in ("serious", "critical")]
        assert [(each["id"], each["nodes"][0]["html"]) for each in serious] == []


@pytest.mark.nightly
def test_a_controller_that_is_silent_is_shown_in_red_and_the_strip_stays_on_the_picture(
    visitor: Visitor, robot: Client
) -> None:
    width, height = SIZES[0]
    page = visitor.open(script=WHOLE, viewport={"width": width, "height": height}, has_touch=True, is_mobile=True)
    expect(page["measured"]).to_be_hidden()
    page.page.evaluate("window.controller.alive = false")
    expect(page["measured"]).to_have_text("Controller silent", use_inner_text=True)
    expect_no_serious_violation(page)
    with measures(robot, LEANING):
        expect(page["battery-known"]).to_have_text("80 %")
        for width, height in SIZES:
            page.page.set_viewport_size({"width": width, "height": height})
            for alive in (False, True):
                page.page.evaluate("(alive) => (window.controller.alive = alive)", alive)
                expect(page["controller-silent"]).to_be_visible(visible=not alive)
                assert page.page.evaluate(COVERED) == [], (width, height)
    expect(page["measured"]).to_be_hidden()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (Kind.CONTROLLER_SILENT, "The controller is silent: whether its servos stop is not known"),
        (Kind.CONTROLLER_RETURNED, "The controller answers again. Nothing moves until something is pressed"),
        (Kind.BATTERY_LOW, "The battery is low. What runs goes on; nothing new starts until it is charged"),
        (Kind.FALLEN, "It has fallen, or was lifted: its legs are stopped"),
    ],
)
def test_what_is_new_of_such_a_robot_is_said_in_plain_words(
    kind: Kind, said: str, visitor: Visitor, robot: Client
) -> None:
    page = visitor.open()
    report(robot, kind, ago_s=60.0)
    expect(page["events"]).to_contain_text(f"{kind} 60.0 s ago")
    expect(page.said).not_to_contain_text(said)
    report(robot, kind)
    expect(page.said).to_contain_text(said)


def test_one_hold_starts_all_six_legs_at_once_lying_and_a_stop_of_one_is_one_of_all(
    visitor: Visitor, robot: Client
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
    seen = states(robot)
    page.page.keyboard.down("h")
    first = seen.wait(lambda state: bool(running(state)))
    assert running(first) == set(SERVO_IDS)
    lying = lying_deg(geometry.load())
    assert {servo.id: servo.angle_deg for leg in first.legs for servo in leg.servos} == pytest.approx(lying, abs=0.01)
    expect(page.said).to_have_text("Running legs 1, 2, 3, 4, 5 and 6 while you hold.")
    page["stop-leg"].click()
    expect(page.said).to_have_text("Stops sent to all six legs.")
    states(robot).wait(lambda state: not running(state))
    page.page.keyboard.up("h")
    page["cal"].locator("summary").click()
    expect(page["cal-whole"]).to_be_visible()
    expect(page["cal-start"]).to_be_disabled()


def running(state: GatewayState) -> set[int]:
    return {servo.id for leg in state.legs for servo in leg.servos if servo.running}


@pytest.mark.nightly
def test_a_rejections_reason_is_said_in_plain_words(visitor: Visitor) -> None:
    said: Any = visitor.open().module(
        "words",
        "(m, all) => [...all.map(m.plain), m.because({ reason: 'whole_robot', detail: 'd' }), m.reasonInWords('old')]",
        ["rejected: battery_low: 6.4 V", "rejected: fallen: 80 degrees", "rejected: stale: late", "leg 1 is lost"],
    )
    assert said == [
        "the battery is low: 6.4 V",
        "it has fallen, or was lifted: 80 degrees",
        "rejected: stale: late",
        "leg 1 is lost",
        "on this robot only all six legs start together: d",
        "old",
    ]


@pytest.mark.nightly
def test_feet_carry_by_comparison_and_the_horizon_turns_as_it_is_seen_from_behind(visitor: Visitor) -> None:
    page = visitor.open()
    carried: Any = page.module(
        "measured",
        "(m, all) => { const feet = new m.Feet(); return all.map((each) => feet.carry(each).map(Number).join('')); }",
        [[0, 0, 0, 0, 0, 0], [4, 0.1, 4, 0.1, 4, 0.1], [1, 1, 1, 1, 1, 1], [0.1, 0.2, 0.1, 0.2, 0.1, 0.2], [None] * 6],
    )
    assert carried == ["000000", "101010", "111111", "000000", "000000"]
    half = 0.5**0.5
    seen: Any = page.module(
        "measured",
        "(m, all) => all.map((each) => m.horizon(each)).map((it) => it && [it.turned, it.raised].map(Math.round))",
        [[1, 0, 0, 0], [2, 0, 0, 0], [half, half, 0, 0], [half, 0, half, 0], [half, 0, 0, half], [0, 0, 0, 0]],
    )
    level, right_side_down, nose_down = [0, 0], [-90, 0], [0, 90]
    assert [seen[0], seen[1], seen[2], seen[4], seen[5]] == [level, level, right_side_down, level, None]
    assert seen[3][1] == nose_down[1]
