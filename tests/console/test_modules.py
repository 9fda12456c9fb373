"""What the modules of the page compute, asked of one page that is open."""

import math
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from gateway import geometry
from gateway.people.walking.robot import Robot
from schemas.robot import LEGS, SERVO_IDS
from tests.console.browser import Opened, Visitor
from tests.support.console_process import Console, SignedIn

pytestmark = [pytest.mark.browser, pytest.mark.nightly]


@pytest.fixture(scope="module")
def page(browser: Browser, console: Console, session: SignedIn) -> Iterator[Opened]:
    with Visitor(browser, console.url, session) as visitor:
        yield visitor.open(webgl=True)


def test_the_page_puts_each_foot_where_the_geometry_does(page: Opened) -> None:
    robot = geometry.load()
    degrees = {servo: (37.0 * servo) % 180 for servo in SERVO_IDS}
    drawn = page.module(
        "kinematics",
        "(m, [geometry, degrees]) => m.LEGS.map((leg) =>"
        " m.legPoints(geometry, leg, m.JOINTS.map((joint) => degrees[leg * 10 + joint]))[4])",
        [robot.model_dump(mode="json"), {str(servo): deg for servo, deg in degrees.items()}],
    )
    for leg, foot in zip(LEGS, drawn, strict=True):
        angles_deg = degrees[10 * leg + 1], degrees[10 * leg + 2], degrees[10 * leg + 3]
        assert foot == pytest.approx(Robot(robot).foot_m(leg, angles_deg), abs=1e-9)
    assert math.dist(drawn[0], drawn[1]) > 0.01


def test_a_hands_slider_moves_a_servo_no_faster_than_60_degrees_a_second(page: Opened) -> None:
    sent = page.module(
        "targets",
        "(m) => { const targets = new m.Targets(); targets.set(11, 100);"
        " return [90, 90, 90].map((commanded) => targets.approach(11, 3, commanded)); }",
    )
    assert sent == [93, 96, 99]


def test_legs_that_begin_to_run_are_drawn_as_commanded_beside_where_they_are(page: Opened) -> None:
    """So many points has the line: each of six legs has four parts, with two ends."""
    points = page.module(
        "scene",
        """(m, geometry) => {
            const scene = new m.Scene(document.createElement("div"), geometry, () => {});
            const poses = (status) => new Map([1, 2, 3, 4, 5, 6].map((leg) =>
                [leg, { degrees: [90, 90, 90], trueDegrees: [90, 60, 90], status, selected: false, carries: null }]));
            const body = { position_m: [0, 0, 0.1], orientation_xyzw: [0, 0, 0, 1], terrain: "flat" };
            const floor = { crossing: () => [0, 0], turned: 0 };
            const counts = ["rests", "runs"].map((status) => {
                scene.update(poses(status), floor, body);
                return scene.ghost.geometry.getAttribute("position").count;
            });
            scene.dispose();
            return counts;
        }""",
        geometry.load().model_dump(mode="json"),
    )
    assert points == [0, 48]


def test_an_abandoned_start_that_is_accepted_is_stopped_again(page: Opened) -> None:
    """A Stop may overtake the start that it follows. Starts of other legs go on."""
    known = page.module(
        "hold",
        "(m, accepted) => {"
        " const stopped = [], ack = { accepted }, starts = new m.Starts((legs) => stopped.push(legs));"
        " [[7, [1]], [8, [2]], [9, [3, 4]]].forEach(([id, legs]) => starts.waiting.set(id, legs));"
        " starts.abandon(2);"
        " const answered = [7, 8, 8].map((id) => starts.answered({ id, ack }) ?? null);"
        " starts.abandon();"
        " return { stopped, answered, left: [starts.answered({ id: 9, ack }) ?? null, starts.waiting.size] }; }",
        True,
    )
    assert known == {"stopped": [[2], [3, 4]], "answered": [[1], None, None], "left": [None, 0]}
