"""A ride, its shell and a gateway in virtual time: no thread, no connection, no sleep.

The gateway judges each start: whether it came too soon behind another leg's, and whether the body allows that
angle: one that stands allows a leg where it was stopped, one that lies allows what pushes no foot below the ground.
"""

import copy
from collections.abc import Callable, Collection, Iterable
from functools import cache
from typing import Final

import pytest

from gateway.errors import DisconnectedError, GatewayError, RejectedError, StoppedError
from gateway.geometry import load
from gateway.people.walking.motion import Posture
from gateway.people.walking.planning import margin_m
from gateway.people.walking.ride import START_PAUSE_S, USUAL_SILENCES, Phase, Ride, RideStep, RideTask, Silences
from gateway.people.walking.robot import Pose, Robot
from schemas.robot import LEGS
from schemas.telemetry import Telemetry
from tests.support.walked import TICK_S

ROBOT: Final = Robot(load())
WHOLE: Final = Robot(load(), starts_whole=True)
"""A robot whose legs only start and stop together."""
FED_SINGLY: Final = Robot(load(), fed_singly=True)
"""A robot whose power board feeds each servo from its start on."""
WATCHDOG_S: Final = 0.25
_NEAR_M: Final = 0.045
"""Above the lowest foot: a foot in mid-swing counts as one that can be put down."""
_LOW_M: Final = 0.005


class Ridden:
    """A ride with its shell, of which `tick` is one turn, and a gateway."""

    def __init__(
        self,
        silences: Silences = USUAL_SILENCES,
        *,
        once: bool = False,
        running: Pose | None = None,
        robot: Robot = ROBOT,
        terrain: str = "level",
    ) -> None:
        self.now_s = 100.0
        self.running: dict[int, tuple[float, float, float]] = dict(running or {})
        self.at: dict[int, tuple[float, float, float]] = dict(self.running)
        """Where each servo was commanded to last, running or not."""
        self._robot = robot
        self.ride = Ride(robot, "tripod", running, silences, once=once, now_s=self.now_s, terrain=terrain)
        self.telemetry: Telemetry | None = None
        self.estopped = self.cut = False
        self.hides: Collection[int] = ()
        """Stops of these legs that the first report leaves out."""
        self.started: list[tuple[float, int]] = []
        self.sent: list[Pose] = []
        self.lies = not self.running
        self._streams: frozenset[int] = frozenset()
        """The legs that a stream would call started."""
        self._over: GatewayError | None = None
        self._commanded_s = self.now_s

    # ---- what others do

    def stop(self, legs: Iterable[int] = LEGS, hides: Collection[int] = ()) -> None:
        """Stop these legs, as somebody else would; the next report leaves out `hides`."""
        for leg in LEGS if self._robot.starts_whole else legs:
            self.running.pop(leg, None)
        self.hides = hides
        self._sink()

    def estop(self) -> None:
        self.estopped = True
        self.stop()

    def wait(self, seconds: float) -> None:
        """Suspend the shell for this time."""
        self.now_s += seconds
        self._watch()

    # ---- the shell

    def tick(self, seconds: float = TICK_S) -> RideStep:
        """Take one turn, so long after the one before. Return what it did last."""
        self.now_s += seconds
        self._watch()
        for _ in range(5):  # questions and Stops, before a setpoint
            step = self.ride.next(self.now_s, self.telemetry)
            try:
                self._carry_out(step)
            except StoppedError as error:
                left = self.ride.stopped(error)
                if left:
                    self._over, self._streams = None, self._streams & left
            except GatewayError as error:
                if self.ride.wants_again and step.do is not RideTask.SEND:
                    self.ride.not_again(error)
                else:
                    self.ride.failed(error)
            self._judge_state()
            if step.do in (RideTask.SEND, RideTask.WAIT):
                return step
            self.now_s += 0.001
        raise AssertionError("it asks and stops without an end")

    def until(self, holds: Callable[[], bool], at_most_s: float = 12.0) -> float:
        """Tick until it holds, and return how long that took."""
        begun_s = self.now_s
        while not holds():
            assert self.now_s - begun_s < at_most_s, (self.ride.phase, self.ride.posture)
            self.tick()
        return self.now_s - begun_s

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.tick()

    def copy(self) -> "Ridden":
        return copy.deepcopy(self, {id(self._robot): self._robot})

    @property
    def posture(self) -> Posture:
        return self.ride.state.posture

    def _carry_out(self, step: RideStep) -> None:
        match step.do:
            case RideTask.FIND:
                self._check_link()
                self.ride.found(self._robot, dict(self.running), self.now_s)
            case RideTask.STOP:
                self.stop(self._streams & self.running.keys())
                self._streams, self._over = frozenset(), None
                self.ride.ended()
                self._check_link()
            case RideTask.SEND:
                self._set(step.pose)
                self.ride.sent(step.pose)

    def _set(self, pose: Pose) -> None:
        """Act as a stream's `set`, which reports before it sends."""
        if self._over is None and self.cut:
            self._over = DisconnectedError("the link to the gateway is lost")
        if self._over is not None:
            raise self._over
        stopped = self._streams - self.running.keys()
        if stopped:
            self._over = StoppedError("somebody stopped it", (stopped - frozenset(self.hides)) or stopped)
            self.hides = ()
            raise self._over
        new = pose.keys() - self._streams
        if new and self.estopped:
            self._over = RejectedError("estopped", "the emergency stop is engaged")
            raise self._over
        self._judge({leg: pose[leg] for leg in new if leg not in self.running})
        self._streams |= new
        self.running |= pose
        self.at |= pose
        self.sent.append(pose)
        self._commanded_s = self.now_s
        self._sink()

    def _check_link(self) -> None:
        if self.cut:
            raise DisconnectedError("the gateway does not answer")

    # ---- the gateway and the floor

    def _watch(self) -> None:
        if self.running and self.now_s - self._commanded_s > WATCHDOG_S:
            self.stop()

    def _sink(self) -> None:
        """Note whether the legs that run hold the body up; once it lies, only all six lift it."""
        if len(self.running) < 3 or (self.lies and len(self.running) < len(LEGS)):
            self.lies = True
            return
        points = [ROBOT.foot_m(leg, angles) for leg, angles in self.running.items()]
        lowest = min(point[2] for point in points)
        feet = [point[:2] for point in points if point[2] < lowest + _NEAR_M]
        self.lies = margin_m((0.0, 0.0), feet) < 0 or -lowest < ROBOT.lying_m + _LOW_M

    def _judge(self, starts: Pose) -> None:
        at_once = (0, len(LEGS)) if self._robot.starts_whole else (0, 1)
        assert len(starts) in at_once, f"legs {sorted(starts)} start at once"
        for leg, angles in starts.items():
            if self.started and not self._robot.starts_whole:
                assert self.now_s - self.started[-1][0] >= START_PAUSE_S - 1e-9, f"leg {leg} starts too soon"
            self.started.append((self.now_s, leg))
            if self.lies:
                below_m = -ROBOT.foot_m(leg, angles)[2] - ROBOT.lying_m
                assert below_m < _LOW_M, f"leg {leg} starts {1000 * below_m:.0f} mm below a body that lies"
            else:
                assert angles == pytest.approx(self.at[leg]), f"leg {leg} leaps"

    def _judge_state(self) -> None:
        """Check that it never reports to stand or to move while nothing runs, and nothing is about to."""
        if self.posture not in (Posture.LYING, Posture.SITTING, Posture.HALTED):
            assert self.ride.phase in (Phase.STARTS, Phase.RUNS), self.posture


@cache
def _stood(silences: Silences, robot: Robot) -> Ridden:
    ridden = Ridden(silences, robot=robot)
    ridden.ride.stand(None, ridden.now_s)
    ridden.until(lambda: ridden.posture is Posture.STANDING)
    return ridden


def standing(silences: Silences = USUAL_SILENCES, robot: Robot = ROBOT) -> Ridden:
    """Return a program's ride, which has stood up."""
    return _stood(silences, robot).copy()
