"""What moves the robot for the bridge: joint commands, a trajectory, or a walk. One of them at a time.

Each stops by itself when its own source falls silent, and sends nothing that its source did not ask for:

- joint commands: nothing is sent without a message, so the gateway's watchdog stops the legs (or lands);
- a trajectory: its last point is held for `REST_S`, or its sender disappears; then it sits down;
- a walk: finishes its step and stands, and sits down later (gateway/people/walking/ride.py).
"""

import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from gateway.errors import GatewayError, StoppedError, WalkError
from gateway.geometry import Geometry
from gateway.people.client.blocking import Client
from gateway.people.client.stream import Stream
from gateway.people.client.walk import Walk, robot_of
from gateway.people.ros2.goals import GoalProgress
from gateway.people.ros2.trajectory import JointsError, Trajectory, legs_deg
from gateway.people.walking.motion import DOWN, STILL, Odometry, Posture, Velocity
from gateway.people.walking.ride import REST_S, Ride, RideTask
from gateway.people.walking.robot import Pose, Robot
from schemas.robot import LEGS

HZ: Final = 50.0
MARGIN_S: Final = 0.25
"""Added to the time after which the gateway's watchdog has stopped silent legs."""
LONGEST_SIT_S: Final = 30.0
STARTS_WHOLE: Final = "this robot starts as a whole: what starts it has to name all 18 joints"
REPLACED: Final = "a newer trajectory has replaced it"
DOES_NOT_STAND: Final = "the robot does not stand; a velocity, or cmd_base_height, makes it stand up"


class JointCommands:
    """Each message becomes one command at once. Legs are started one more with each message, and draw most then.

    A robot that starts as a whole is started by a message with all its joints.
    """

    title = "joint_commands"

    def __init__(self, client: Client, geometry: Geometry) -> None:
        self._geometry = geometry
        self.stream = client.stream(HZ)
        state = client.state()
        self._silent_s = state.watchdog.stops_after_ms / 1000 + MARGIN_S
        self._whole = state.wire.whole_robot
        self.stream.open()
        self._started: frozenset[int] = frozenset()
        self._received_s = time.monotonic()

    def command(self, at_rad: dict[int, float]) -> None:
        """Send servo → radians, of whole legs. Raises as `Stream.send`; JointsError if they cannot start it."""
        sent = next_start(legs_deg(self._geometry, at_rad), self._started, whole=self._whole)
        self.stream.send({**sent})
        self._started |= sent.keys()
        self._received_s = time.monotonic()

    def check(self, now_s: float) -> bool:
        if now_s - self._received_s > self._silent_s:
            raise StoppedError(f"{self.title} fell silent, and the gateway has stopped its legs", self._started)
        return True

    def end(self, *, sits: bool) -> None:
        """Stop the legs. The robot does not sit down first: its pose is unknown."""
        del sits
        self.stream.close()


class Course:
    """The poses of a trajectory in time, and what follows its end or its sender's. Pure: time is an argument."""

    def __init__(self, robot: Robot, ride: Callable[[Pose], Ride]) -> None:
        """`ride` makes one of legs that run already; it may raise WalkError.

        A started servo may have no supply for `robot.limp_s`. Until then a plan waits.
        """
        self._robot = robot
        self._fed_s = self._advanced_s = -math.inf
        """When all that run have their supply; when the plan was looked at last."""
        self._make_ride = ride
        self._plan: Trajectory | None = None
        self._at: Pose = {}
        self._sent: Pose = {}
        """The last angles that were sent to the started legs."""
        self._sending: frozenset[int] = frozenset()
        """Legs of the pose that was sent last, or is being sent."""
        self._rests_s = math.inf
        """The time at which it sits down."""
        self._ride: Ride | None = None
        """The ride that sits down; None before."""
        self._left = REPLACED
        """Why the plan is no longer followed."""

    @property
    def begun(self) -> bool:
        """Whether there is a pose to send."""
        return self._plan is not None or bool(self._at)

    def follow(self, plan: Trajectory, now_s: float) -> None:
        """Follow `plan` from the present angles. Raises JointsError if the plan cannot begin there."""
        self._advance(now_s)
        running = self._running()
        plan.begin(self._rad(running), now_s)
        self._next_start({**running, **legs_deg(self._robot.geometry, plan.at(now_s))})
        self._at = running
        self._plan, self._ride, self._rests_s, self._left = plan, None, plan.ends_s + REST_S, REPLACED

    def progress(self, plan: Trajectory, now_s: float) -> GoalProgress:
        if plan is not self._plan:
            return GoalProgress({}, {}, self._left)
        self._advance(now_s)
        return GoalProgress(plan.at(now_s), self._rad(self._sent))

    def hold(self, plan: Trajectory | None, now_s: float) -> None:
        """Stay where this plan is now (None: whichever is followed), as long as at its end; then sit down.

        A leg that has not started by then is not started.
        """
        if self._plan is not None and plan in (None, self._plan) and self._ride is None:
            self._advance(now_s)
            self._at = self._running()
            self._plan, self._rests_s, self._left = None, now_s + REST_S, "it was cancelled"

    def lose_sender(self, now_s: float) -> None:
        """Sit down now, unless the plan has ended: nobody could cancel the rest."""
        if self._plan is not None and now_s < self._plan.ends_s:
            self.leave(now_s, "its sender has left the graph, so the robot sits down")

    def leave(self, now_s: float, why: str = "the bridge was released") -> None:
        """Plan to sit down from now on; `next` returns the steps."""
        self._advance(now_s)
        self._plan, self._rests_s, self._left = None, min(self._rests_s, now_s), why

    def next(self, now_s: float) -> Pose | None:
        """Return the pose to send; None: the course is over, and running servos must be stopped."""
        self._advance(now_s)
        if self._robot.limp_s and self._ride is None and not self._at.keys() <= self._sent.keys():
            self._fed_s = now_s + self._robot.limp_s
        if self._ride is None and now_s >= self._rests_s:
            self._ride = self._sitting(now_s)
            if self._ride is None:
                return None
        if self._ride is None:
            pose = self._next_start(self._at)
        else:
            step = self._ride.next(now_s)
            if step.do is not RideTask.SEND:
                return None
            self._ride.sent(step.pose)
            pose = self._at = step.pose
        self._sending = frozenset(pose)
        return pose

    def sent(self, pose: Pose) -> None:
        """Record that the pose was sent and its starts accepted."""
        self._sent = {**self._sent, **pose}

    def _running(self) -> Pose:
        """Return where the legs are that have started, or are being started."""
        return {leg: at for leg, at in self._at.items() if leg in self._sent or leg in self._sending}

    def _next_start(self, pose: Pose) -> Pose:
        return next_start(pose, frozenset(self._sent), whole=self._robot.starts_whole)

    def _rad(self, pose: Pose) -> dict[int, float]:
        return {
            10 * leg + joint: at_rad
            for leg, angles in pose.items()
            for joint, at_rad in enumerate(self._robot.joints_rad(leg, angles), start=1)
        }

    def _advance(self, now_s: float) -> None:
        if self._plan is not None and self._ride is None:
            if self._advanced_s < self._fed_s:  # the plan stands still until then
                waited_s = min(now_s, self._fed_s) - self._advanced_s
                self._plan.begins_s += waited_s
                self._rests_s += waited_s
            self._at = {**self._at, **legs_deg(self._robot.geometry, self._plan.at(now_s))}
        self._advanced_s = now_s

    def _sitting(self, now_s: float) -> Ride | None:
        """What lies down from where the legs are; None where it cannot: then they are stopped as they are.

        With a leg that does not run, a ride that is sent away before its first word sends nothing.
        """
        pose = {leg: at for leg, at in self._at.items() if leg in self._sent}
        try:
            ride = self._make_ride(pose)
            ride.found(ride.robot, pose, now_s)
        except WalkError:
            return None
        ride.leave(now_s)
        return ride


class Following:
    """Follows trajectories on a thread of its own: the newest replaces the older one."""

    title = "joint_trajectory"

    def __init__(self, client: Client, geometry: Geometry) -> None:
        robot = partial(robot_of, client, geometry)
        self._course = Course(robot(client.state()), lambda pose: Ride(robot(client.state()), running=pose))
        self._changed = threading.Condition()
        self._is_there: Callable[[], bool] = lambda: True
        self._over = False
        self._stops = False
        """At once."""
        self._error: GatewayError | None = None
        self._stream: Stream = client.stream(HZ)
        self._stream.open()
        self._thread = threading.Thread(target=self._run, name="follow a trajectory", daemon=True)
        self._thread.start()

    def follow(self, plan: Trajectory, is_there: Callable[[], bool]) -> None:
        """Follow it from now on. `is_there` returns whether its sender still exists."""
        with self._changed:
            if self._error is not None:
                raise self._error.with_traceback(None)
            self._course.follow(plan, time.monotonic())
            self._is_there = is_there
            self._changed.notify_all()

    def progress(self, plan: Trajectory) -> GoalProgress:
        with self._changed:
            if self._error is not None:
                return GoalProgress({}, {}, self._error.lasting)
            return self._course.progress(plan, time.monotonic())

    def hold(self, plan: Trajectory | None) -> None:
        """Hold where this plan is now, if it is followed (None: any); then sit down."""
        with self._changed:
            self._course.hold(plan, time.monotonic())

    def check(self, now_s: float) -> bool:
        with self._changed:
            if self._error is not None:
                raise self._error.with_traceback(None)
            if not self._is_there():
                self._course.lose_sender(now_s)
            return self._course.begun and not self._over

    def end(self, *, sits: bool) -> None:
        with self._changed:
            self._stops = not sits or not self._course.begun
            self._course.leave(time.monotonic())
            self._changed.notify_all()
        self._thread.join(LONGEST_SIT_S if sits else None)
        self._stream.close()

    # ---- its thread

    def _run(self) -> None:
        try:
            while (pose := self._next()) is not None:
                self._stream.set(pose)
                with self._changed:
                    self._course.sent(pose)
        except GatewayError as error:
            self._error = error
        except (ValueError, RuntimeError) as error:
            self._error = WalkError(str(error))

    def _next(self) -> Pose | None:
        """Return the next pose to send; None: it is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._course.begun or self._stops)
            pose = None if self._stops else self._course.next(time.monotonic())
            self._over = pose is None
        return pose


class Walking:
    """Velocities and the body's pose, through `Client.walk`; it stands up with the first."""

    title = "cmd_vel"

    def __init__(self, client: Client, geometry: Geometry, gait: str, begins: Odometry) -> None:
        """`begins`: where the walk before it ended."""
        self._begins = begins
        self._walk: Walk = client.walk(gait, geometry)
        self._walk.open()
        self._body = {"roll_rad": 0.0, "pitch_rad": 0.0}

    @property
    def odometry(self) -> tuple[Odometry, Velocity]:
        """The robot's place since the first walk, and its velocity, both by its steps."""
        if (state := self._walk.latest) is None:
            return self._begins, STILL
        return self._begins.then(state.odometry), state.scaled if state.posture == Posture.WALKING else STILL

    def go(self, velocity: Velocity) -> None:
        """Walk at this velocity for half a second. Raises WalkError, or the error that ended the walk."""
        if not velocity.moves and self._walk.state.posture in DOWN:  # it would start the servos
            return
        self._walk.go(*velocity, wait=False)

    def stand(self, **change: float) -> None:
        """Change the body's `height_m`, `roll_rad` or `pitch_rad`. A walk pauses for it. Raises as `go`."""
        if "height_m" not in change and self._walk.state.posture in DOWN:
            raise WalkError(DOES_NOT_STAND)
        body = self._body | change
        if body != self._body:
            self._walk.stand(**{"height_m": self._walk.state.height_m, **body}, wait=False)
            self._body = body

    def walk_as(self, gait: str) -> None:
        """Change the gait; a walk pauses for it."""
        if gait != self._walk.state.gait:
            self._walk.walk_as(gait)

    def check(self, now_s: float) -> bool:
        if self._walk.error is not None:
            raise self._walk.error.with_traceback(None)
        del now_s
        return not self._walk.is_over

    def end(self, *, sits: bool) -> None:
        self._walk.close(sits=sits)


def next_start(legs: Pose, started: frozenset[int], *, whole: bool) -> Pose:
    """Of these legs, those that run already, and one more; of a robot that starts as a `whole`, all.

    Raises JointsError where a leg is missing that has to start with them.
    """
    new = sorted(legs.keys() - started)
    if whole and new and legs.keys() != set(LEGS):
        raise JointsError(STARTS_WHOLE)
    return {leg: angles for leg, angles in legs.items() if whole or leg in started or leg in new[:1]}


Motion = JointCommands | Following | Walking
"""`check` returns whether it continues, and raises the error that ended it. `end` stops the servos that it started."""
