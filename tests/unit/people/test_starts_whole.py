"""Programs learn from the state that only the whole robot starts, and start all six legs at once."""

import time
from collections.abc import Mapping
from typing import Any, Final

import pytest

from gateway.errors import UnansweredError
from gateway.geometry import load
from gateway.people.client.stream import Stream
from gateway.people.ros2.motions import STARTS_WHOLE, Following, JointCommands
from gateway.people.ros2.trajectory import JointsError, Trajectory, Waypoint
from schemas.robot import LEGS, SERVO_IDS
from schemas.telemetry import Ack, WireReport
from tests.unit.people import test_stream

GEOMETRY: Final = load()
ALL_RAD: Final = {servo_id: GEOMETRY.joint_rad(servo_id, 90) for servo_id in SERVO_IDS}
ONE_LEG_RAD: Final = {servo_id: at for servo_id, at in ALL_RAD.items() if servo_id < 20}


class Robot(test_stream.Robot):
    """Its state says what its wire can do; what it was asked is kept."""

    def __init__(self, *, whole: bool) -> None:
        super().__init__()
        self.changed = {"wire": WireReport(name="any", whole_robot=whole)}
        self.legs: list[list[int]] = []

    def calibration(self) -> Any:
        raise UnansweredError("an older gateway has none")

    def stream(self, hz: float) -> Stream:
        found: Any = self
        return Stream(found, hz)

    def ask(self, key: str, payload: Mapping[str, Any], *, again: bool = False) -> Ack:
        self.legs.append(sorted(map(int, payload["legs"])))
        return super().ask(key, payload, again=again)


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> Any:
    robot = Robot(whole=True)
    monkeypatch.setattr("gateway.people.client.stream.time", robot)
    return robot


def test_joint_commands_start_all_legs_at_once_and_a_message_with_fewer_starts_none(whole: Any) -> None:
    motion = JointCommands(whole, GEOMETRY)
    with pytest.raises(JointsError, match=STARTS_WHOLE):
        motion.command(ONE_LEG_RAD)
    motion.command(ALL_RAD)
    assert whole.legs == [list(LEGS)]
    motion.command(ONE_LEG_RAD)  # what runs is not started again
    motion.end(sits=False)
    assert whole.legs[1:] == [list(LEGS)], "its Stop"


def test_a_trajectory_without_all_joints_starts_nothing_and_leaves_the_robot_to_others(whole: Any) -> None:
    motion = Following(whole, GEOMETRY)
    with pytest.raises(JointsError, match=STARTS_WHOLE):
        motion.follow(Trajectory((Waypoint(1.0, ONE_LEG_RAD),), time.monotonic()), lambda: True)
    assert not motion.check(time.monotonic())
    motion.end(sits=True)
    assert whole.legs == []
