"""A robot that lands when a link is cut in mid-walk: laptops with certificates, and an observer on the robot itself.

Each frame that nobody commanded is held against what was commanded before it. How late Stops are is printed
(`pytest -rP`), and bounded as in test_lease.py.
"""

import os
import re
from collections.abc import Iterator
from typing import Any

import pytest

from gateway.model.frames import decode
from schemas.robot import LEGS
from schemas.telemetry import Cause, Event, FrameRecord, Kind
from tests.net.conftest import Hosts
from tests.net.hosts import TIMEOUT_MS, LaptopHost, RobotHost, is_from, with_certificates
from tests.net.namespaces import Network
from tests.support.child import Child
from tests.support.gateway_process import COMMAND
from tests.support.way_down import EARLY_MS, Seen, Way, reported

pytestmark = pytest.mark.net

PORT = 7451
LANDING_MS = 2000.0
"""A link that is back is heard of again within a second, since TCP tries more and more seldom."""
HZ = 100.0
"""Twice as often as a laptop streams, so that no command waits."""
POSE = {10 * leg + joint: angle for leg in LEGS for joint, angle in ((1, 90.0), (2, 30.0), (3, 150.0))}
del POSE[63]
LATE_MS = 500
"""What a busy machine may add."""


class Scene(Hosts):
    """The robot, the laptops, and what the landing looks like."""

    def __init__(self, robot: RobotHost, anna: LaptopHost, bert: LaptopHost) -> None:
        super().__init__(robot, (anna, bert))
        self.anna, self.bert = anna, bert

    def walk(self, laptop: LaptopHost, *legs: int) -> None:
        """All of these legs at 50 Hz."""
        laptop.start(*legs)
        laptop.stream(*legs)
        self.robot.wait_for_frames(is_from(laptop), 10 * len(legs))

    def wait_for(self, kind: Kind) -> Event:
        return self.robot.wait_for_event(lambda event: event.kind == kind)

    def seen(self, *causes: Cause) -> list[FrameRecord]:
        """What was written since the robot was last at rest, in its order."""
        return self.robot.seen(lambda frame: frame.cause in causes)

    def way(self, landing: Event) -> Way:
        """What the landing has to do; the event names the leg that was silent first."""
        self.robot.wait_for_frames(lambda frame: frame.cause is Cause.WATCHDOG, 1)
        (silent,) = re.findall(r"leg ([1-6]) was not heard", landing.detail)
        commanded = reported(self.seen(Cause.COMMAND))
        return Way.after(commanded, int(silent), POSE, timeout_ms=TIMEOUT_MS, landing_ms=LANDING_MS, hz=HZ)

    def check_way_down(self, landing: Event) -> list[Seen]:
        """All commands, then a straight line, then six Stops in time, and nothing else; the line."""
        self.robot.wait_for_frames(lambda frame: frame.cause is Cause.WATCHDOG and is_stop(frame), len(LEGS))
        self.wait_for(Kind.WATCHDOG_EXPIRED)
        ours = reported(self.seen(Cause.WATCHDOG))
        down, stops = ours[: -len(LEGS)], ours[-len(LEGS) :]
        frames = self.seen(*Cause)
        assert [frame.cause for frame in frames[-len(ours) :]] == [Cause.WATCHDOG] * len(ours)
        assert {frame.cause for frame in frames[: -len(ours)]} == {Cause.COMMAND}
        way = self.way(landing)
        way.check(down)
        assert [(each.leg, each.frame.is_stop) for each in stops] == [(leg, True) for leg in LEGS]
        late_ms = [each.at_ms - way.begins_ms - LANDING_MS for each in stops]
        print(f"{len(down)} frames down; the six Stops were {late_ms[0]:.2f} to {late_ms[-1]:.2f} ms late")
        assert -EARLY_MS < late_ms[0] < late_ms[-1] < LATE_MS
        assert not self.robot.running
        return down


@pytest.fixture(scope="module")
def running_scene(hosts_network: Network, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    """Started once for all tests of this file."""
    folder = tmp_path_factory.mktemp("landing")
    settings: dict[str, dict[str, Any]] = {
        "watchdog": {"landing_ms": LANDING_MS},
        "watchdog.landing": {str(servo_id): angle for servo_id, angle in POSE.items()},
        "limits": {"leg_rate_hz": HZ},
        "lease": {"ttl_ms": 10_000},
        "state": {"path": str(folder / "black box")},
    }
    with with_certificates(hosts_network, folder, "anna", "bert", port=PORT, settings=settings) as (robot, laptops):
        anna, bert = laptops
        yield Scene(robot, anna, bert)


@pytest.fixture
def scene(running_scene: Scene, network: Network) -> Scene:
    """Links are up, nobody drives, nothing runs."""
    del network
    for laptop in running_scene.laptops:
        laptop.ask("pause")
        laptop.wait_for_answer()
        laptop.ask("release")
    running_scene.robot.at_rest()
    return running_scene


def is_stop(frame: FrameRecord) -> bool:
    return decode(bytes.fromhex(frame.bytes)).is_stop


def test_a_link_that_is_cut_in_mid_walk_lands_the_robot_in_a_straight_line_and_then_stops_it(
    scene: Scene, network: Network
) -> None:
    scene.walk(scene.anna, *LEGS)
    network.cut(0)
    down = scene.check_way_down(scene.wait_for(Kind.LANDING))
    network.fix(0)
    check_story(scene.robot, len(down))


def check_story(robot: RobotHost, frames_down: int) -> None:
    """What a person reads of it afterwards."""
    child = Child([*COMMAND, "incidents", "show", "last", "--config", str(robot.gateway.config)], os.environ)
    assert child.wait() == 0, child
    child.close()
    print(child.stdout)
    head, *lines = (line.strip() for line in child.stdout.splitlines())
    assert "-landing: a leg was silent, and the robot went to its landing pose, at " in head
    wanted = [
        r"−0\.5\d\d s  last command of leg 1 \(laptop 0, set .* 60 90\)",
        r"0\.000 s  landing: leg \d was not heard for 500 ms; the robot lands, and is stopped 2000 ms later",
        r"\+\S+ m?s  first frame of the way down",
        rf"\+1\.9\d\d s  last frame of the way down, after {frames_down} frames; "
        r"legs 1, 2, 3, 4, 5 at 90 30 150; leg 6 at 90 30 90",
        r"\+[12]\.\d+ s  Stop written to all six legs \(watchdog\), \d+ µs after the deadline, the last at \+2\.\d+ s",
        r"\+2\.\d+ s  watchdog: the robot has landed; all six legs are stopped",
    ]
    found = [next((place for place, line in enumerate(lines) if re.fullmatch(each, line)), -1) for each in wanted]
    assert -1 not in found, child.stdout
    assert found == sorted(found), child.stdout
