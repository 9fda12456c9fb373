"""The calibration on the console's page, on a real gateway with a simulated controller."""

import re
from collections.abc import Callable, Iterator

import pytest
from playwright.sync_api import expect

from gateway.client import Client
from schemas.calibration import ServoChange
from tests.console.browser import PHONE, Opened, Visitor
from tests.support.gateway_process import Gateway
from tests.support.heard import states

pytestmark = pytest.mark.browser


@pytest.fixture(autouse=True)
def as_drawn(gateway: Gateway) -> Iterator[None]:
    """Undo whatever a test wrote."""
    yield
    with gateway.client() as robot, robot.lease(take=True):
        assert robot.calibrate({32: ServoChange(trim_deg=0, inverted=False, min_deg=0, max_deg=180)}).accepted


def running(robot: Client) -> dict[int, float | None]:
    return {servo.id: servo.angle_deg for leg in robot.state().legs for servo in leg.servos if servo.running}


def start_32(page: Opened, begin: str = "90") -> None:
    """Open the calibration and start servo 32, after its question."""
    page.get_lease()
    page.show_rest()
    page["cal-title"].click()
    expect(page["cal-revision"]).to_have_text(re.compile("revision"))
    page["cal-servo"].select_option("32")
    page["cal-begin"].fill(begin)
    page["cal-start"].click()
    page["question-yes"].click()
    expect(page["cal-now"]).to_contain_text("Servo 32 runs at")


@pytest.mark.nightly
def test_a_servo_is_started_alone_jogged_trimmed_turned_round_and_written(visitor: Visitor, watcher: Client) -> None:
    page = visitor.open(viewport=PHONE["viewport"])
    before = watcher.calibration().revision
    start_32(page)
    for _ in range(3):
        page["cal-up"].click()
    expect(page["cal-now"]).to_have_text("Servo 32 runs at 93°")
    expect(page["leg-row-3"]).to_contain_text("93.0°")
    assert running(watcher) == {32: 93}
    page["cal-measured"].fill("90")
    page["cal-measured"].press("Enter")
    expect(page["cal-now"]).to_have_text("Servo 32 runs at 90°, 93° by the calibration in force")
    page["cal-highest_here"].click()
    page["cal-wrong_way"].click()
    expect(page["cal-rows"]).to_contain_text("* +3° inverted 90–180°")
    page["cal-undo"].click()
    expect(page["cal-rows"]).to_contain_text("* +3° 0–90°")
    expect(page["cal-write"]).to_be_disabled()

    page["cal-stop"].click()
    page.expect_status(3, "rests")
    page["cal-write"].click()
    assert watcher.calibration().revision == before, "nothing is written before it is confirmed"
    page["question-yes"].click()
    expect(page.said).to_contain_text(f"written: revision {before + 1}")
    written = watcher.calibration().servos["32"]
    assert (written.trim_deg, written.inverted, written.min_deg, written.max_deg) == (3, False, 0, 90)


def fold(page: Opened) -> None:
    page["cal-title"].click()


def stop_all(page: Opened) -> None:
    page["stop-all"].click()


@pytest.mark.parametrize("leave", [Opened.hide, Opened.close, fold, stop_all, Opened.lose_focus])
def test_leaving_in_any_way_stops_the_servo(visitor: Visitor, watcher: Client, leave: Callable[[Opened], None]) -> None:
    page = visitor.open()
    start_32(page)
    page.expect_status(3, "runs")
    leave(page)
    states(watcher).wait(lambda state: not any(servo.running for servo in state.legs[2].servos))


def test_a_lease_that_is_taken_and_somebody_elses_stop_end_it(visitor: Visitor, gateway: Gateway) -> None:
    page = visitor.open()
    start_32(page)
    page.expect_status(3, "runs")
    with gateway.client(source="a program") as robot:
        assert robot.stop(3).accepted
        expect(page.said).to_contain_text("the servo is stopped")
        page["cal-start"].click()
        page["question-yes"].click()
        expect(page["cal-now"]).to_be_visible()
        page.expect_status(3, "runs")
        with robot.lease(take=True):
            expect(page["cal-start"]).to_be_disabled()
            page.expect_status(3, "rests")
