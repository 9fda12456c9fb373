"""One ride, from a driver's first command until all its legs are stopped. Pure: time is an argument.

A shell (a program's walk, the console's, the bridge's) has the thread, the connection and the clock. It calls `next`,
carries out the result, and reports the outcome: `sent`, `found`, `stopped`, `failed` or `ended`.

| phase | what runs | leaves it by |
|---|---|---|
| RESTS | nothing | a command: STARTS |
| STARTS | legs that ran already, and one more each `START_PAUSE_S`; none that runs moves | all fed and there: RUNS |
| RUNS | all six, by the engine | silence, after it has sat down: ENDS |
| HALTED | some; somebody stopped the others. Feet in the air are put down, and nothing moves | `start_again` |
| FAILED | nothing is sent; the gateway's watchdog stops what runs | `start_again` |
| ENDS | nothing is sent; the shell stops what runs | `ended`: RESTS |

- A robot that starts as a whole starts all six legs at once, lying; a Stop of one leg stops them all, so it never
  halts.
- A leg starts where it was stopped only if, by the gateway's newest state, exactly the others run, and they carry the
  body. Otherwise the body has sunk: all legs are stopped, and it begins anew from lying.
- No command is used twice. `hold_s` after the newest one the robot finishes its step and stands, `rest_s` after it the
  robot sits down and is stopped. The end of a walk (silence, an error, sitting down) uses up the newest press: only a
  newer one moves the robot. Programs have `start_again` and their next call in place of presses.
"""

import math
from collections.abc import Mapping
from enum import Enum, auto
from typing import Final, NamedTuple

from gateway.errors import GatewayError, StoppedError, WalkError
from gateway.people.walking.balance import terrain_named
from gateway.people.walking.engine import Engine
from gateway.people.walking.inverse import Angles
from gateway.people.walking.motion import DOWN, ORIGIN, STILL, BodyPose, Odometry, Posture, Velocity, WalkState
from gateway.people.walking.robot import Pose, Robot, Stance
from schemas.robot import LEGS
from schemas.telemetry import Telemetry

START_PAUSE_S: Final = 0.015
"""The least pause between the starts of two legs, when servos draw most: a tick of 50 Hz, less its jitter."""
GIVES_UP_S: Final = 2.0
"""How long a fallen or lifted robot stands still; then nothing is sent, so the gateway stops it."""
_ALL: Final = frozenset(LEGS)


class Silences(NamedTuple):
    """How many seconds each kind of silence may last."""

    hold_s: float = 0.5
    """After a command. Then the robot stands, and its press is used up; as in diff_drive_controller and twist_mux."""
    rest_s: float = 10.0
    """After a command. A robot that stands then sits down and is stopped: servos that hold it up get hot."""
    idle_s: float = math.inf
    """After a press, or a wish that moves, although wishes continue. Then the robot sits down as well."""
    halted_s: float = math.inf
    """After a command, if a lost leg keeps the robot from sitting. Then the robot is stopped where it stands."""


class Wish(NamedTuple):
    """A driver's complete wish, which it repeats. `press` counts the pushes of buttons."""

    press: int
    velocity: Velocity = STILL
    gait: str = "tripod"
    height_m: float | None = None
    """The body's height; None: the usual height."""
    sits: bool = False
    barred: str = ""
    """Why its velocity may not be driven now. This uses up the press, and the walk ends at once, not with its step."""


USUAL_SILENCES: Final = Silences()


class Phase(Enum):
    """The phases of a ride: see the module's table."""

    RESTS = auto()
    STARTS = auto()
    RUNS = auto()
    HALTED = auto()
    FAILED = auto()
    ENDS = auto()


class RideTask(Enum):
    """The shell's next task; see `RideStep`."""

    WAIT = auto()
    """Wait until `wake_s`, or until there is something to report."""
    FIND = auto()
    """Ask the gateway for its state, and call `found`."""
    SEND = auto()
    """Send the pose, start its legs that do not run yet (acknowledged), and call `sent`."""
    STOP = auto()
    """Stop the ride's legs, and call `ended`."""


class RideStep(NamedTuple):
    """The next task, and when to call `next` again at the latest (monotonic seconds)."""

    do: RideTask
    pose: Mapping[int, Angles] = {}
    wake_s: float = math.inf


class Ride:
    """The state of one ride. Not for several threads at once. Times are seconds of one monotonic clock."""

    # mutants accepted (Forget, Step): the first look sets it; no press is below 0
    def __init__(
        self,
        robot: Robot,
        gait: str = "tripod",
        running: Pose | None = None,
        silences: Silences = USUAL_SILENCES,
        *,
        once: bool = False,
        now_s: float = 0.0,
        terrain: str = "level",
    ) -> None:
        """`running`: legs that run already, in degrees; if all six do, they are held at once for their watchdog.

        `once`: over permanently after it has sat down or failed. Raises WalkError for an unknown gait or terrain.
        """
        self._once = once
        self._terrain = terrain_named(terrain)
        self.silences = silences
        """The ride's times. May be changed at any time."""
        self.phase = Phase.RESTS
        self.error: GatewayError | None = None
        """The error that ended the ride, until `start_again` has succeeded."""
        self.over = False
        """The driver is silent or has left, and the legs are stopped. A command starts them again, unless `once`."""
        self.detail = ""
        """Why the newest press moves nothing: a sentence for people."""
        self.spent = -1
        """The newest press that is used up."""
        self._press = -1
        self._obeyed: Wish | None = None
        """The newest wish that was obeyed; None: the next counts as changed."""
        self._leaving = False
        self.wants_again = False
        """Whether `start_again` was called, and its outcome is not known yet."""
        self._takes_over = running is not None and running.keys() == _ALL
        """Before the first command: begin only if all six legs still run."""
        self._found = False
        """Whether the gateway was asked who runs, since the legs were last at rest."""
        self._ours = False
        """Whether legs that this ride started may run."""
        self._running: frozenset[int] = frozenset()
        self._arrived = True
        """Whether started servos have arrived."""
        self._sent: dict[int, Angles] = {}
        """The angles (degrees) last sent to each leg."""
        self._started_s = -math.inf
        self._sound_s = now_s
        """When the robot had last neither fallen nor been lifted."""
        self._said_s = self._pressed_s = now_s
        self._begin(robot, gait, running or {})
        if self._takes_over:
            self.phase = Phase.STARTS

    # ---- its driver's commands; each raises `error`, or WalkError for what these legs cannot do

    def go(self, velocity: Velocity, now_s: float) -> None:
        """Walk at this velocity for `hold_s`; a robot that lies stands up first."""
        self._check()
        if velocity.moves:
            self._engine.stance.check_walks()
            if self._engine.posture in DOWN:
                self._sits = False
                self._engine.stand()
        self._velocity = velocity
        self._wanted(now_s)

    def stand(self, body: BodyPose | None, now_s: float) -> None:
        """End the walk, and stand at this pose (None: as before)."""
        self._check()
        stance = None if body is None else self.robot.stance(body)
        self._velocity, self._sits = STILL, False
        self._engine.stand(stance)
        self._prepare(stance)
        self._wanted(now_s)

    def sit(self, now_s: float) -> None:
        """End the walk, and lie down on the belly."""
        self._check()
        self._lie_down(now_s)
        self._wanted(now_s)

    def walk_as(self, gait: str, now_s: float) -> None:
        """Change the gait. A walk pauses until that is done."""
        self._engine.walk_as(gait)
        self._said_s = now_s

    def wish(self, wish: Wish, now_s: float) -> None:
        """Carry out the changes to the newest wish. With a used press a wish only shows that the driver is there."""
        self.apply_silences(now_s)
        self._said_s = now_s
        if wish.press > self._press:
            self._press, self._pressed_s, self.detail = wish.press, now_s, ""
            self.start_again()
        if wish.barred and wish.velocity.moves and not wish.sits and wish.press > self.spent:
            self._spend(wish.barred)
            self._engine.brake()
        if self.over or self.error is not None:
            return
        if wish.press <= self.spent or self._leaving:
            self._velocity = STILL
            return
        try:
            self._obey(wish, now_s)
        except WalkError as error:
            self._obeyed = None
            self._spend(str(error))

    def leave(self, now_s: float) -> None:
        """The driver leaves: sit down now, and move nothing after that."""
        if not self._leaving:
            self._leaving = True
            self._sit_down(now_s)

    def start_again(self) -> None:
        """Go on after an error, by a person's decision. Only lost legs are started."""
        self.wants_again = self.error is not None and not (self._once and self.over)

    # ---- what the shell does

    def next(self, now_s: float, telemetry: Telemetry | None = None) -> RideStep:
        """Return the task to do now. `telemetry`: None if none is fresh."""
        self.apply_silences(now_s)
        if self.wants_again:
            return RideStep(RideTask.STOP if self.phase is Phase.FAILED and self._ours else RideTask.FIND)
        pose: Pose = {}
        if self.phase in (Phase.RUNS, Phase.HALTED):
            pose = self._tick(now_s, telemetry)
            self.apply_silences(now_s)  # it may have sat down by this tick
        elif self.phase is Phase.STARTS and not self._found:
            return RideStep(RideTask.FIND)
        elif self.phase is Phase.STARTS:
            pose = self._next_start(now_s)
        match self.phase:
            case Phase.ENDS:
                return RideStep(RideTask.STOP)
            case Phase.RESTS | Phase.FAILED:
                waits = self.phase is Phase.RESTS and not self.over
                return RideStep(RideTask.WAIT, wake_s=self._said_s + self.silences.rest_s if waits else math.inf)
        self._ours = True
        return RideStep(RideTask.SEND, pose)

    def apply_silences(self, now_s: float) -> None:  # mutants accepted (Step): 1 s later
        """Apply the silences. If the ride ends, its running legs are to be stopped."""
        if self._found and now_s - self._started_s > self.robot.limp_s > 0:
            self._run_if_started()
        silent_s = now_s - self._said_s
        if silent_s > self.silences.hold_s:
            self.spent = max(self.spent, self._press)
        ends = (self._sits and (self._press >= 0 or self._leaving)) or self._is_silent(self._ticked_s)
        fault = self._engine.felt.fault  # a robot that has fallen, or hangs in somebody's hands, cannot sit
        if not fault or self.phase is not Phase.RUNS:
            self._sound_s = now_s
        to_end = silent_s > self.silences.rest_s or (self._sits and not self._takes_over)
        match self.phase:
            case Phase.RUNS if fault and to_end:
                self._spend(fault)
                self._end()
            case Phase.RUNS if now_s - self._sound_s > GIVES_UP_S:
                self.failed(WalkError(fault))
            case Phase.RUNS if ends and self._engine.posture in DOWN:
                self._end()
            case Phase.RUNS if now_s - self._pressed_s > self.silences.idle_s and not self._sits:
                self._sit_down(now_s)
                self.detail = f"nothing was pressed for {self.silences.idle_s:g} s, so it sits down"
            case Phase.HALTED if silent_s > self.silences.halted_s:
                self._end()
            case Phase.RESTS if silent_s > self.silences.rest_s:
                self.over = True

    def found(self, robot: Robot, running: Pose, now_s: float) -> None:
        """Answer FIND: by the gateway's newest state these legs run, at these angles. Raises WalkError."""
        engine = self._engine
        if not self.wants_again:
            if running or engine.posture not in DOWN:
                engine.find(running)
            self._found, self._running = True, frozenset(running)
            if self._takes_over and self._running != _ALL:
                self.phase = Phase.RESTS
        elif self.phase is Phase.HALTED and running.keys() == _ALL - engine.lost and engine.carries:
            self.phase, self._running = Phase.STARTS, frozenset(running)
            self._goes_on(now_s)
        elif self._ours:
            self.phase = Phase.FAILED
        else:
            self._begin(robot, engine.gait_name, running, engine.state.odometry)
            self.phase, self._found = Phase.RESTS, False
            self._goes_on(now_s)

    def sent(self, pose: Pose, *, arrived: bool = True) -> None:
        """This pose was sent, and its starts were accepted. `arrived`: whether all servos are where they were sent.

        A servo that was stopped a moment ago needs up to a second from there (`limits.takeover_deg_s`).
        """
        self._arrived = arrived
        self._running = self._running.union(pose)  # `|= pose.keys()` would make a set, which `_next_start` then changes
        self._sent |= pose
        if not self.robot.limp_s:
            self._run_if_started()

    def stopped(self, error: StoppedError) -> frozenset[int]:
        """Take the legs of `error` as stopped.

        Return the legs that stand still from now on; if none, the ride has failed. Without a question to the gateway:
        over a slow link their watchdog would stop them before its answer.
        """
        engine = self._engine
        left = self._running - frozenset(error.legs)
        stands = self.phase in (Phase.RUNS, Phase.HALTED) or bool(engine.lost)
        if stands:
            error.legs = tuple(sorted(_ALL - left))
        if not (left and stands):
            self.failed(error)
            return frozenset()
        self._velocity = STILL
        engine.halt(_ALL - left, self._sent)
        self._running = left
        self._ends_by(error)
        self.phase = Phase.HALTED
        return left

    def failed(self, error: GatewayError) -> None:
        """Send nothing more: the gateway stops what still runs."""
        self._ends_by(error)
        self.phase = Phase.FAILED
        self.over = self._once

    def not_again(self, error: Exception) -> None:
        """`start_again` has failed; the ride stays as it was."""
        self.wants_again = False
        self._spend(error.lasting if isinstance(error, GatewayError) else str(error))

    def ended(self) -> None:
        """Record that the legs are stopped. A command that came in the meantime starts them again."""
        self._ours, self._found, self._running = False, False, frozenset()
        if self.phase is Phase.ENDS:
            self.phase = Phase.RESTS if self.over else Phase.STARTS

    # ---- its state

    @property
    def posture(self) -> Posture:
        """The robot's posture; standing or moving only while legs run or are being started."""
        posture = self._engine.posture
        if self.phase is Phase.FAILED:
            return Posture.HALTED
        return posture if posture in DOWN or self.phase is not Phase.RESTS else Posture.LYING

    @property
    def robot(self) -> Robot:
        """The robot, with the limits that were in force when it began."""
        return self._engine.robot

    @property
    def body(self) -> BodyPose:
        """The body's pose in which the robot stands and walks."""
        return self._engine.stance.body

    @property
    def state(self) -> WalkState:
        """See `WalkState`; after a StoppedError with its legs as `lost`."""
        engine = self._engine
        return WalkState(
            posture=self.posture,
            gait=engine.gait_name,
            height_m=engine.state.body.height_m,
            commanded=self._velocity,
            scaled=engine.scaled,
            limit=engine.limit,
            odometry=engine.state.odometry,
            lost=self.error.legs if isinstance(self.error, StoppedError) else tuple(sorted(engine.lost)),
            terrain=self._terrain,
            tilt_deg=engine.felt.tilt_deg,
            carrying=engine.felt.carrying,
            corrected_deg=math.degrees(engine.corrected_rad),
            hanging=tuple(sorted(engine.state.hanging)),
        )

    # ---- inside

    def _begin(self, robot: Robot, gait: str, running: Pose, odometry: Odometry = ORIGIN) -> None:
        self._engine = Engine(robot, gait, running, odometry)
        self._velocity = STILL
        self._sits = True
        """Whether the robot is to lie; false after a command to stand or walk."""
        self._ticked_s = self._busy_s = -math.inf
        """When the robot was last moved, and when it was last on its way to another posture."""
        self._prepare()

    def _prepare(self, stance: Stance | None = None) -> None:
        """Compute the feet's wider places now, which takes longer than a tick."""
        if self._terrain == "adapt":
            self.robot.widened((stance or self._engine.stance).body)

    def _tick(self, now_s: float, telemetry: Telemetry | None) -> Pose:
        """Return the angles of all legs now, in degrees."""
        if now_s - self._said_s > self.silences.hold_s:
            self._velocity = STILL
        if self._engine.posture is Posture.MOVING:
            self._busy_s = now_s
        elif self._engine.posture is Posture.STANDING and self._is_silent(now_s):
            self._sits = True
            self._engine.sit()
        elapsed_s = now_s - self._ticked_s if math.isfinite(self._ticked_s) else 0.0
        self._ticked_s = now_s
        return self._engine.step(self._velocity, elapsed_s, telemetry if self._terrain == "adapt" else None)

    def _is_silent(self, now_s: float) -> bool:
        """Return whether `rest_s` is over, since the newest command or the end of a change of posture."""
        return now_s - max(self._said_s, self._busy_s) > self.silences.rest_s

    def _check(self) -> None:
        if self.error is not None:
            raise self.error.with_traceback(None)

    def _wanted(self, now_s: float) -> None:
        self._said_s, self.over, self._takes_over = now_s, False, False
        if self.phase is Phase.RESTS:
            self.phase = Phase.STARTS

    def _obey(self, wish: Wish, now_s: float) -> None:
        if wish.sits:
            self._sit_down(now_s)
            return
        if wish.velocity.moves:
            self._pressed_s = now_s
        before, self._obeyed = self._obeyed, wish
        if wish.gait != (self._engine.gait_name if before is None else before.gait):
            self._engine.walk_as(wish.gait)
        if before is None or self._sits or wish.height_m != before.height_m:
            self.stand(BodyPose(self.robot.usual_m if wish.height_m is None else wish.height_m), now_s)
        self.go(wish.velocity, now_s)

    def _run_if_started(self) -> None:
        if self.phase is Phase.STARTS and self._running == _ALL and self._arrived:
            self.phase = Phase.RUNS
            if self._engine.lost:
                self._engine.resume()

    def _next_start(self, now_s: float) -> Pose:
        legs = self._running
        missing = sorted(_ALL - legs)
        if self.robot.starts_whole:
            legs = _ALL
        elif missing and now_s - self._started_s >= START_PAUSE_S:
            self._started_s = now_s
            legs |= {missing[0]}
        pose = self._engine.state.pose
        return {leg: pose[leg] for leg in sorted(legs)}

    def _sit_down(self, now_s: float) -> None:
        """Use up the newest press. A robot that has not stood up yet, or cannot sit, is stopped."""
        self._spend("")
        stood = self.phase is Phase.STARTS and (self._running == _ALL or bool(self._engine.lost))
        if self.phase is Phase.RUNS or stood:
            self._lie_down(now_s)
        elif self.phase is not Phase.ENDS:
            self._end()

    def _lie_down(self, now_s: float) -> None:
        self._said_s, self._velocity, self._sits = now_s, STILL, True
        self._engine.sit()

    def _end(self) -> None:
        self.over = True
        self.phase = Phase.ENDS if self._ours else Phase.RESTS

    def _spend(self, detail: str) -> None:
        self.spent, self.detail = max(self.spent, self._press), detail

    def _ends_by(self, error: GatewayError) -> None:
        self.error, self._obeyed = error, None
        self._spend(error.lasting)

    def _goes_on(self, now_s: float) -> None:
        self.error, self.wants_again = None, False
        self._said_s = self._pressed_s = now_s
        self._velocity = STILL
