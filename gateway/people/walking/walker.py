"""Drives the engine by the clock, and stops by itself when its driver is silent. Pure: time is an argument.

It assumes that all six legs run; `Ride` starts and stops them.

- A velocity holds for `hold_s`. Then the robot finishes its step and stands.
- Without any command for `rest_s` the robot sits down; after that `is_over`, and the servos may be stopped.
"""

import math
from typing import Final, NamedTuple

from gateway.people.walking.balance import terrain_named
from gateway.people.walking.engine import Engine
from gateway.people.walking.motion import ORIGIN, STILL, Odometry, Velocity
from gateway.people.walking.robot import Pose, Robot, Stance
from gateway.people.walking.ways import Posture
from schemas.telemetry import Telemetry

HOLD_S: Final = 0.5
"""As in diff_drive_controller and twist_mux."""
REST_S: Final = 10.0
"""Servos that hold a robot up get hot."""
LONGEST_S: Final = 30.0
"""Longer than any way to a posture, even with servos ten times slower than usual."""


class WalkState(NamedTuple):
    """The state of a walk."""

    posture: Posture
    gait: str
    height_m: float
    commanded: Velocity
    """The requested velocity; 0 after `hold_s`."""
    scaled: Velocity
    """The velocity that the legs can reach: the same direction, slower for the reason in `limit`."""
    limit: str
    odometry: Odometry
    """Where its steps have carried it since the walk began."""
    lost: tuple[int, ...]
    """Legs that somebody else has stopped."""
    terrain: str = "level"
    """`adapt`: it walks by its sensors, where there are some."""
    tilt_deg: float | None = None
    """Of the body against the world's up, as measured; None: not measured."""
    carrying: tuple[bool, ...] | None = None
    """Which of legs 1 to 6 carry, as measured."""
    corrected_deg: float = 0.0
    """How far the body leans against its feet, so as to be level."""
    hanging: tuple[int, ...] = ()
    """Legs that found no ground."""


DOWN: Final = (Posture.LYING, Posture.SITTING)


class Walker:
    """One walk. Not for several threads at once; times are seconds of one monotonic clock."""

    def __init__(
        self,
        robot: Robot,
        gait: str = "tripod",
        angles_deg: Pose | None = None,
        *,
        hold_s: float = HOLD_S,
        rest_s: float = REST_S,
        odometry: Odometry = ORIGIN,
        terrain: str = "level",
    ) -> None:
        """`angles_deg`: of legs that run already. `odometry`: where it begins. Raises WalkError."""
        self.terrain = terrain_named(terrain)
        self.engine = Engine(robot, gait, angles_deg, odometry)
        self._prepare()
        self.hold_s = hold_s
        self.rest_s = rest_s
        self._velocity = STILL
        self._said_s: float | None = None
        self._ticked_s: float | None = None
        self._busy_s: float | None = None
        """When it last moved to another posture."""
        self.sits = True
        """Whether it is to lie; false after a command to stand or walk."""

    def go(self, velocity: Velocity, now_s: float) -> None:
        """Walk at this velocity for `hold_s`; a robot that lies or sits stands up first. Raises WalkError."""
        if velocity.moves:
            self.engine.stance.check_walks()
        self._said_s = now_s
        self._velocity = velocity
        if velocity.moves and self.engine.posture in DOWN:
            self.sits = False
            self.engine.stand()

    def stand(self, stance: Stance | None, now_s: float) -> None:
        """End the walk, and stand at this stance (None: as before)."""
        self._said_s = now_s
        self._velocity = STILL
        self.sits = False
        self.engine.stand(stance)
        self._prepare(stance)

    def sit(self, now_s: float) -> None:
        """End the walk, and lie down on the belly."""
        self._said_s = now_s
        self._velocity = STILL
        self.sits = True
        self.engine.sit()

    def halt(self, legs: frozenset[int], sent: Pose) -> None:
        """Somebody else has stopped these legs: the command ends, and the others stand still."""
        self._velocity = STILL
        self.engine.halt(legs, sent)

    def walk_as(self, gait: str, now_s: float) -> None:
        """Change the gait at the next step. Raises WalkError."""
        self.engine.walk_as(gait)
        self._said_s = now_s

    def tick(self, now_s: float, telemetry: Telemetry | None = None) -> Pose:
        """The angles of all legs now, in degrees. `telemetry`: None if none is fresh."""
        if self._said_s is None:
            self._said_s = now_s
        if now_s - self._said_s > self.hold_s:
            self._velocity = STILL
        posture = self.engine.posture
        if posture is Posture.MOVING:
            self._busy_s = now_s
        elif posture is Posture.STANDING and self._is_silent(now_s):
            self.sits = True
            self.engine.sit()
        elapsed_s = 0.0 if self._ticked_s is None else now_s - self._ticked_s
        self._ticked_s = now_s
        return self.engine.step(self._velocity, elapsed_s, telemetry if self.terrain == "adapt" else None)

    @property
    def is_over(self) -> bool:
        """Whether its driver is silent and the robot down, so that it does not fall when its servos are stopped."""
        silent = self._ticked_s is not None and self._is_silent(self._ticked_s)
        return silent and self.engine.posture in DOWN

    def _prepare(self, stance: Stance | None = None) -> None:
        """Find out now what takes longer than a tick."""
        if self.terrain == "adapt":
            self.engine.robot.widened((stance or self.engine.stance).body)

    def _is_silent(self, now_s: float) -> bool:
        since_s = max(self._said_s or 0.0, self._busy_s or 0.0)
        return now_s - since_s > self.rest_s

    @property
    def state(self) -> WalkState:
        """See `WalkState`."""
        engine = self.engine
        return WalkState(
            posture=engine.posture,
            gait=engine.gait_name,
            height_m=engine.body.height_m,
            commanded=self._velocity,
            scaled=engine.scaled,
            limit=engine.limit,
            odometry=engine.odometry,
            lost=tuple(sorted(engine.lost)),
            terrain=self.terrain,
            tilt_deg=engine.felt.tilt_deg,
            carrying=engine.felt.carrying,
            corrected_deg=math.degrees(engine.corrected_rad),
            hanging=tuple(sorted(engine.hanging)),
        )
