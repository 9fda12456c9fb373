"""What the modules of the page compute, asked of one page that is open."""

import math
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from gateway import geometry
from gateway.geometry.kinematics import foot_m
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
    joints = {servo: robot.joint_rad(servo, degrees[servo]) for servo in SERVO_IDS}
    drawn = page.module(
        "kinematics",
        "(m, [geometry, degrees]) => m.LEGS.map((leg) =>"
        " m.legPoints(geometry, leg, m.JOINTS.map((joint) => degrees[leg * 10 + joint]))[4])",
        [robot.model_dump(mode="json"), {str(servo): deg for servo, deg in degrees.items()}],
    )
    for leg, foot in zip(LEGS, drawn, strict=True):
        assert foot == pytest.approx(foot_m(robot, leg, joints), abs=1e-9)
    assert math.dist(drawn[0], drawn[1]) > 0.01


def test_how_late_a_state_is_shows_although_clocks_differ(page: Opened) -> None:
    """States that waited in a frozen page, or behind it, are as old as they are, not as new as their arrival."""
    late = page.module(
        "model",
        "(m, came) => { const lateness = new m.Lateness(); return came.map(([up, at]) => lateness.received(up, at)); }",
        [[1000, 5000], [1100, 5100], [1200, 6300], [1300, 6301], [2400, 6400], [50, 6500], [150, 6601]],
    )
    assert late == [0, 0, 1100, 1001, 0, 0, 1]


def test_the_floor_goes_as_the_feet_that_stand_do(page: Opened) -> None:
    """Four feet on the ground go back and turn about the body; two swing."""
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


def test_behind_the_robot_ahead_is_up_and_left_is_left_whatever_way_it_was_turned_before(page: Opened) -> None:
    """Ahead on the pad is ahead in the picture."""
    middle, ahead, left = page.module(
        "scene",
        """async (m, geometry) => {
            const { Vector3 } = await import("/vendor/three/three.module.js");
            const place = document.createElement("div");
            place.style.cssText = "width: 300px; height: 200px";
            document.body.append(place);
            const scene = new m.Scene(place, geometry, () => {});
            scene.azimuth = 1;
            scene.chase();
            scene.draw();
            const seen = [[0, 0], [0.4, 0], [0, 0.4]].map(([x, y]) => scene.at(new Vector3(x, y, -0.1)));
            scene.dispose();
            place.remove();
            return seen;
        }""",
        geometry.load().model_dump(mode="json"),
    )
    assert ahead[1] < middle[1] - 20
    assert ahead[0] == pytest.approx(middle[0], abs=0.5)
    assert left[0] < middle[0] - 20


def test_the_way_it_goes_is_drawn_to_the_side_that_it_turns_to(page: Opened) -> None:
    ways = page.module(
        "course",
        "(m, all) => all.map((going) => m.course(going))",
        [[0, 0, 0], [0.1, 0, 0], [0, 0, 0.4], [0, 0, -0.4], [0, 0.1, 0]],
    )
    angle = 4 * 0.4
    tips = [way[len(way) // 2] for way in ways[1:]]
    assert ways[0] == []
    assert tips[0] == pytest.approx([0.7 + 0.09, 0])
    assert tips[1] == pytest.approx([0.3 * math.cos(angle) - 0.09, 0.3], abs=0.003)
    assert tips[2] == pytest.approx([0.3 * math.cos(angle) - 0.09, -0.3], abs=0.003)
    assert tips[3] == pytest.approx([0.3, 0.4 + 0.09])


def test_a_links_quality_is_its_worst_of_two_seconds(page: Opened) -> None:
    seen = page.module(
        "quality",
        "(m, all) => { const quality = new m.Quality(); return all.map((each) => quality.take(...each).bars); }",
        [[0, 100, 20], [100, 250, 20], [200, 60, 450], [300, 600, 20], [2250, 100, 50], [2350, 100, 50]],
    )
    assert seen == [3, 2, 1, 0, 0, 3]


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
