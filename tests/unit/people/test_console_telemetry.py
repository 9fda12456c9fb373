"""What a page gets of a robot that measures, and of one of which only the whole starts."""

import json
from typing import Any, cast

import pytest

from gateway import geometry
from gateway.people.console.pages.outgoing import Outgoing
from gateway.people.console.pages.pages import Page, Pages
from gateway.people.walking import Engine, Robot
from gateway.people.walking.planning import lying_deg
from schemas.robot import LEGS
from schemas.telemetry import Report, Telemetry, WireReport
from tests.support.published import WALL, state

SECOND_NS = 1_000_000_000


class Kept(Outgoing):
    """Keeps all that is put in."""

    def __init__(self) -> None:
        super().__init__()
        self.put_in: list[Report] = []

    def put(self, message: Report) -> None:
        self.put_in.append(message)
        super().put(message)


class OpenPage:
    """As much of a page as `Pages` uses."""

    def __init__(self) -> None:
        self.outgoing = Kept()

    def allow_age(self, max_age_ms: float) -> None:
        """It sends nothing."""


class Clock:
    """Virtual time."""

    now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


def measured(tilt_deg: float) -> Telemetry:
    return Telemetry(time=WALL, age_ms=1.0, tilt_deg=tilt_deg)


def opened(clock: Clock) -> tuple[Pages, Kept]:
    pages, page = Pages("", lambda: 0, clock), OpenPage()
    pages.add(cast("Page", page))
    page.outgoing.put_in.clear()
    return pages, page.outgoing


@pytest.mark.parametrize("rate_hz", [5, 10, 100])
async def test_telemetry_reaches_a_page_ten_times_in_any_second_at_most(rate_hz: int) -> None:
    clock = Clock()
    pages, outgoing = opened(clock)
    sent_ns = []
    for number in range(20 * rate_hz):
        clock.now_ns = number * SECOND_NS // rate_hz
        before = len(outgoing.put_in)
        pages.received_telemetry(measured(number))
        sent_ns += [clock.now_ns] * (len(outgoing.put_in) - before)
    most = max(sum(at <= each < at + SECOND_NS for each in sent_ns) for at in sent_ns)
    assert most <= 10
    assert len(sent_ns) >= 20 * min(rate_hz, 8), "and no page waits for more than an eighth of a second"


async def test_a_page_that_reads_nothing_is_kept_one_telemetry_and_what_is_not_measured_is_left_out() -> None:
    clock = Clock()
    pages, outgoing = opened(clock)
    for number in range(100):
        clock.now_ns = number * SECOND_NS
        pages.received_telemetry(measured(number))
    texts = [json.loads(text) for text in await outgoing.wait()]
    newest = next(each for each in texts if each["type"] == "telemetry")
    assert [each["type"] for each in texts] == ["link", "telemetry"]
    assert newest["telemetry"].keys() == {"time", "age_ms", "tilt_deg"}
    assert newest["telemetry"]["tilt_deg"] == 99


@pytest.mark.parametrize("whole", [False, True])
async def test_a_state_tells_a_page_whether_only_the_whole_robot_starts(*, whole: bool) -> None:
    pages, outgoing = opened(Clock())
    report = state().model_copy(update={"wire": WireReport(whole_robot=whole)})
    pages.received_state(report, 0)
    messages: list[dict[str, Any]] = [json.loads(text) for text in await outgoing.wait()]
    assert [each["whole"] for each in messages if each["type"] == "state"] == [whole]


def test_a_page_knows_the_pose_from_which_a_walk_begins() -> None:
    robot = geometry.load()
    lying = lying_deg(Robot(robot))
    pose = {leg: (lying[10 * leg + 1], lying[10 * leg + 2], lying[10 * leg + 3]) for leg in LEGS}
    engine = Engine(Robot(robot), angles_deg=pose)
    assert engine.is_down
    assert all(engine.robot.foot_m(leg, pose[leg])[2] > -engine.robot.lying_m for leg in LEGS), "no foot pushes"
