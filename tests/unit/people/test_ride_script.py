"""`walk --seconds`, in virtual time: how long it walks, and how it is ended early."""

from collections.abc import Callable
from typing import Final, cast

import pytest

from gateway.people.client.walk import Walk
from gateway.people.commands.walk.script import AtOnce, EndRequests, go
from gateway.people.walking import Posture, Velocity, WalkState
from gateway.people.walking.motion import BodyPose
from tests.support.ridden import Ridden

AHEAD: Final = Velocity(0.1)


class Walked:
    """As `Walk` is to a program: each call waits for what it asks for."""

    def __init__(self, ticked: Callable[["Walked"], None] = lambda _: None) -> None:
        self.ridden = Ridden()
        self.walked_s = 0.0
        self._ticked = ticked

    @property
    def state(self) -> WalkState:
        return self.ridden.ride.state

    def go(self, forward_m_s: float = 0.0, left_m_s: float = 0.0, turn_rad_s: float = 0.0) -> None:
        begun_s = self.ridden.now_s
        self.ridden.ride.go(Velocity(forward_m_s, left_m_s, turn_rad_s), begun_s)
        self.ridden.tick()
        if forward_m_s:
            self.walked_s += self.ridden.now_s - begun_s
        self._ticked(self)

    def stand(self, height_m: float | None = None, *, wait: bool = True) -> None:
        self.ridden.ride.stand(None if height_m is None else BodyPose(height_m), self.ridden.now_s)
        if wait:
            self.ridden.until(lambda: self.ridden.posture is Posture.STANDING)

    def sit(self) -> None:
        self.ridden.ride.sit(self.ridden.now_s)
        self.ridden.until(lambda: self.ridden.posture is Posture.SITTING)

    def clock(self) -> float:
        return self.ridden.now_s


def test_it_stands_up_walks_for_so_long_and_sits(capsys: pytest.CaptureFixture[str]) -> None:
    robot = Walked()
    assert go(cast(Walk, robot), AHEAD, 1.0, 0.14, EndRequests(), robot.clock)
    assert robot.walked_s == pytest.approx(1.0, abs=0.05)
    assert robot.state.posture is Posture.SITTING
    assert 0.02 < robot.state.odometry.x_m < 0.15
    said = capsys.readouterr().out
    assert said.startswith("walked 0.")
    assert said.endswith("m to the left, turned by 0°; it sits, and its servos are stopped\n")


@pytest.mark.parametrize("when", [Posture.MOVING, Posture.WALKING])
def test_ended_early_it_finishes_its_step_and_sits(when: Posture, capsys: pytest.CaptureFixture[str]) -> None:
    end = EndRequests()

    def asks(robot: Walked) -> None:
        if robot.state.posture is when and robot.ridden.now_s > 101:
            end.asked = True

    robot = Walked(asks)
    assert not go(cast(Walk, robot), AHEAD, 600.0, None, end, robot.clock)
    assert robot.walked_s < 0.2
    assert robot.state.posture is Posture.SITTING
    assert capsys.readouterr().out.startswith("ended early: walked ")


def test_asked_twice_it_is_cut_but_not_while_its_stops_are_sent() -> None:
    end = EndRequests()
    end.ask()
    with pytest.raises(AtOnce):
        end.ask()
    end.ask()
    other = EndRequests()
    other.stops()
    other.ask()
    other.ask()
