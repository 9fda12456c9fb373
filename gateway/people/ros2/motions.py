"""What moves the robot for the bridge: joint commands or a walk. One of them at a time.

Each stops by itself when its own source falls silent, and sends nothing that its source did not ask for:

- joint commands: nothing is sent without a message, so the gateway's watchdog stops the legs (or lands);
- a walk: finishes its step and stands, and sits down later (gateway/people/walking/ride.py).
"""

import time
from typing import Final

from gateway.errors import StoppedError, WalkError
from gateway.geometry import Geometry
from gateway.people.client.blocking import Client
from gateway.people.client.walk import Walk
from gateway.people.ros2.joints import JointsError, legs_deg
from gateway.people.walking.motion import DOWN, STILL, Odometry, Posture, Velocity
from gateway.people.walking.robot import Pose
from schemas.robot import LEGS

HZ: Final = 50.0
MARGIN_S: Final = 0.25
"""Added to the time after which the gateway's watchdog has stopped silent legs."""
STARTS_WHOLE: Final = "this robot starts as a whole: what starts it has to name all 18 joints"
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

    def check(self) -> bool:
        if time.monotonic() - self._received_s > self._silent_s:
            raise StoppedError(f"{self.title} fell silent, and the gateway has stopped its legs", self._started)
        return True

    def end(self, *, sits: bool) -> None:
        """Stop the legs. The robot does not sit down first: its pose is unknown."""
        del sits
        self.stream.close()


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

    def check(self) -> bool:
        if self._walk.error is not None:
            raise self._walk.error.with_traceback(None)
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


Motion = JointCommands | Walking
"""`check` returns whether it continues, and raises the error that ended it. `end` stops the servos that it started."""
