"""The gait engine: body velocities in, servo angles out. Pure: time is an argument.

**Stance.** All feet that stand move as one rigid body against the robot's motion, so none scrapes.
**Swing.** A foot leaves the ground with the ground's velocity, and lands with it where the middle of its next stance is
the foot's resting place. So a stride needs no memory of the one before, and a change of velocity no special case.
**Tempo.** If strides would be too long for the discs, the same gait takes less time, with lower steps.
**Limits.** Each foot stays in a disc around its resting place (robot.py). A velocity that would carry a standing foot
out of its disc is scaled down, as a whole vector. If a servo is too slow, that tick counts less time: feet and body
move the same way, only slower.
"""

import math
from collections import deque
from collections.abc import Iterable
from typing import Final

from gateway.errors import WalkError
from gateway.people.walking import balance, gait_speed, gaits, transitions
from gateway.people.walking.balance import NOTHING, Felt, Senses
from gateway.people.walking.feet import State, Swing
from gateway.people.walking.motion import ORIGIN, STILL, BodyPose, Odometry, Posture, Velocity, carried, travelled
from gateway.people.walking.planning import Planner, balanced
from gateway.people.walking.robot import LIFT_M, WIDE_RAD, Pose, Robot, Stance, largest
from schemas.robot import LEGS
from schemas.telemetry import Telemetry

_LATE_M: Final = 0.002
"""How far a foot may leave its disc: it is lifted at a tick, up to one tick late."""
_LEAST_FEET: Final = 3
_LEANS_LESS: Final = 0.97
_TRIES: Final = 8
_LONGEST_S: Final = 0.1
"""The longest time that counts for one tick, so that a late tick moves nothing further."""


class Engine:
    """Walks, stands and sits. Call `step` once a tick. Not for several threads at once."""

    def __init__(
        self, robot: Robot, gait: str = "tripod", angles_deg: Pose | None = None, odometry: Odometry = ORIGIN
    ) -> None:
        """`angles_deg`: the last commanded angles of the legs that run; the others are slack and may be anywhere.

        Raises WalkError if the robot can neither stand nor sit, and for an unknown gait.
        """
        self.robot = robot
        self.gait_name, self._gait = gait, gaits.gait(gait)
        self._quick, self._lift_m, self._climb = gait_speed.at_tempo(self._gait, 1.0)
        """The gait at its present tempo, and its swings."""
        self._least_tempo = gait_speed.least(robot)
        self._next_gait: str | None = None
        self.stance = robot.stance(BodyPose(robot.usual_m))
        """The stance in which the robot stands and walks."""
        self._planner = Planner(robot)
        self.commanded = STILL
        self.scaled = STILL
        self.limit = ""
        """Why the velocity is scaled down, as a sentence; "" if it is not."""
        self.lost: frozenset[int] = frozenset()
        """Legs that somebody else has stopped: `step` leaves them out."""
        self._senses = Senses()
        self.felt = NOTHING
        """The sensors' report at the latest step."""
        self._leans_rad = balance.LEANS_RAD
        """The most that the body may lean; reduced after a lean left the legs no stride."""
        self._barred = ""
        """Why no velocity has an effect, until a command to stand still."""
        self._stuck = False
        self._pace = 1.0
        self._slowest = 0
        """The ID of the last servo that was too slow; 0: none."""
        self._cap: tuple[object, float] = (None, 1.0)
        """The latest velocity, stance and gait, and the part (0 to 1) of it whose strides fit into the discs."""
        self._wanted: deque[Stance | None] = deque(maxlen=1)
        self._brakes = False
        """Whether a walk ends at once; see `brake`."""
        self.state = State(BodyPose(0.0), {}, {}, odometry=odometry)
        """The robot after the latest step; the pose of a lost leg is its last commanded one."""
        self.find(angles_deg or {})

    # ---- commands

    def step(self, velocity: Velocity, seconds: float, telemetry: Telemetry | None = None) -> Pose:
        """Return the angles (degrees) of all legs after `seconds` (0.1 at most) towards this velocity.

        With fresh `telemetry` the body keeps level, and feet find uneven ground (balance.py).
        """
        seconds = max(0.0, min(seconds, _LONGEST_S))
        self.commanded = velocity
        stands = not (self.state.sits or self.state.moves)
        self.felt = felt = self._senses.take(telemetry, seconds, stands=stands)
        self._barred = felt.fault or (self._barred if velocity.moves else "")
        if felt.fault:  # a leg that moves now may meet a hand
            self.limit, self.scaled = felt.fault, STILL
            return self.pose
        self._begin_what_is_wanted()
        before, pace, slowest, holds = self.state, 1.0, 0, False
        pending = before.sits or before.moves or self._wanted or self._next_gait or self.lost or self._brakes
        target = STILL if pending or self._barred or before.goes_over(velocity) else velocity
        if self._cap[0] != (key := (target, self.stance, self._gait)):
            most = gait_speed.TEMPO_SPARE / self._least_tempo
            self._cap = key, largest(lambda part: self._stride_of(target.times(part)) <= most)
        _, cap = self._cap
        for _ in range(_TRIES):
            after = before.copy()
            try:
                self._advance(after, target.times(cap), seconds * pace, felt, holds=holds)
            except WalkError as error:  # what the discs and the plans are there to prevent
                if felt is not NOTHING and not holds:  # it leans further than its strides allow
                    holds, self._leans_rad = True, _LEANS_LESS * min(self._leans_rad, self.corrected_rad)
                    continue
                before.velocity, before.moves, before.part = STILL, (), 0.0
                self.limit, self._stuck = str(error), True
                break
            ratio, servo_id = gait_speed.fastest(self.robot, before.pose, after.pose, seconds)
            slowest = servo_id if ratio > 1.0 else slowest
            if ratio <= 1.0:
                self.state, self._stuck = after, False
                break
            pace *= min(0.98 / ratio, 0.9)
        self._report(target, cap, pace, seconds, slowest)
        return self.pose

    def stand(self, stance: Stance | None = None) -> None:
        """End the walk, and go to this stance (`Robot.stance`; None: the latest)."""
        self._wanted.append(stance or self.stance)

    def sit(self) -> None:
        """End the walk and lie down, so that the servos may be stopped."""
        self._wanted.append(None)

    def brake(self) -> None:
        """End the walk within `HALT_S`, not with its step: the body stops, and feet in the air come straight down."""
        self._brakes, self.state.brake_s = True, 0.0

    def walk_as(self, gait: str) -> None:
        """Change the gait. A walk pauses until that is done. Raises WalkError for an unknown gait."""
        gaits.gait(gait)
        self._next_gait = gait

    def find(self, angles_deg: Pose) -> None:
        """Begin again from the angles of the running legs, as in `__init__`. Commands and odometry are kept."""
        found = self._planner.found(angles_deg)
        self.state = State(found.body, found.feet, found.pose, found.moves, found.sits, odometry=self.state.odometry)

    def halt(self, legs: Iterable[int], sent: Pose) -> None:
        """Put down all legs but these, which somebody else has stopped, and stand still until `resume`.

        `sent`: the angles that were last sent, which may differ from the latest step's.
        """
        lost = frozenset(legs)
        if not self.lost <= lost:
            self.resume()  # for those that run again
        self._wanted.clear()
        state = self.state
        state.pose |= {leg: angles for leg, angles in sent.items() if leg in lost - self.lost}
        self.lost = lost
        state.brake_s = 0.0
        for leg in self.lost:
            state.swings.pop(leg, None)
        move = state.moves[0] if state.moves else None
        hanging = [leg for leg in getattr(move, "paths", ()) if leg not in self.lost]
        state.moves, state.part = (), 0.0
        self._lower(hanging)

    def resume(self) -> None:
        """The lost legs run again, at their former angles: put them down, so that the walk can go on."""
        legs, self.lost = self.lost, frozenset()
        self.state.ground(self.robot, legs)
        self._lower(leg for leg in LEGS if leg not in self.state.swings)  # others may still be moving down

    @property
    def carries(self) -> bool:
        """Whether the other legs carry the body, or it lies. Else it has sunk, and the lost legs' angles would lift it.

        A foot that is being lowered counts.
        """
        left = [leg for leg in LEGS if leg not in self.lost]
        lies = self.state.body.height_m < self.robot.lying_m + transitions.ON_GROUND_M
        return lies or balanced(self.robot, self.state, left)

    # ---- its state

    @property
    def posture(self) -> Posture:
        """The robot's posture; MOVING while it changes."""
        state = self.state
        if self.lost:
            return Posture.HALTED
        if state.swings or state.velocity.moves:
            return Posture.WALKING
        if state.moves or self._wanted:
            return Posture.MOVING
        if not state.sits:
            return Posture.STANDING
        down = all(foot[2] < transitions.ON_GROUND_M for foot in state.feet.values())
        return Posture.SITTING if down else Posture.LYING

    @property
    def pose(self) -> Pose:
        """The angles (degrees) of all legs that are not lost, after the latest step."""
        return {leg: angles for leg, angles in self.state.pose.items() if leg not in self.lost}

    @property
    def corrected_rad(self) -> float:
        """The body's lean against its feet, which keeps it level (radians)."""
        return max(abs(now - asked) for now, asked in zip(self.state.body[1:], self.stance.body[1:], strict=True))

    # ---- postures

    def _begin_what_is_wanted(self) -> None:
        """Once the robot stands still, change the gait, then begin the way to another posture."""
        state = self.state
        if state.swings or state.velocity.moves or state.moves or self.lost:
            return
        self._brakes = False
        if self._next_gait is not None:
            self.gait_name, self._gait = self._next_gait, gaits.gait(self._next_gait)
            self._next_gait = None
            # No velocity would lift feet that the former gait left outside of this gait's discs.
            outside = any(math.dist(state.feet[leg], rest) > self._within_m for leg, rest in self.stance.feet.items())
            if outside and not state.sits and not self._wanted:
                self.stand()
        if self._wanted:
            wanted = self._wanted.popleft()
            self.stance = wanted or self.stance
            state.moves, state.rests = self._planner.way(state, wanted), {}
            state.sits, state.part = wanted is None, 0.0

    def _lower(self, legs: Iterable[int]) -> None:
        state = self.state
        hanging = [leg for leg in legs if state.feet[leg][2] > 0.0]
        if hanging and not state.sits:
            state.moves, state.part = (transitions.lowered(state.feet, hanging),), 0.0

    # ---- one tick

    def _advance(self, state: State, target: Velocity, seconds: float, felt: Felt, *, holds: bool) -> None:
        if not state.moves:
            body, feet = state.body, dict(state.feet)
            if felt is not NOTHING and not state.sits and not self.lost:
                self._adapt(state, seconds, felt)
            if not holds:
                self._walk(state, target, seconds, felt)
            state.place(self.robot, [leg for leg in LEGS if state.feet[leg] != feet[leg] or state.body != body])
            return
        move = state.moves[0]
        state.part = min(1.0, state.part + seconds / move.seconds)
        move.put(state, self.robot, state.part)  # `halt` has left out the lost legs
        if state.part == 1.0:
            state.moves, state.part = state.moves[1:], 0.0

    def _adapt(self, state: State, seconds: float, felt: Felt) -> None:
        """Level the body, and let it climb with its feet."""
        state.hanging -= {leg for leg, touches in felt.feet.items() if touches}
        self._leans_rad = min(balance.LEANS_RAD, self._leans_rad + balance.LEANS_MORE_RAD_S * seconds)
        state.body = balance.levelled(state.body, self.stance.body, felt, self._leans_rad, seconds)
        state.rise(seconds)
        stand = state.feet.keys() - state.swings.keys() - state.hanging
        down_m = balance.lowered_by([state.feet[leg][2] for leg in stand], seconds)
        if down_m:
            state.feet = {leg: (x, y, z - down_m) for leg, (x, y, z) in state.feet.items()}

    def _walk(self, state: State, target: Velocity, seconds: float, felt: Felt) -> None:
        gait = self._quick
        began = not state.velocity.moves and not state.swings
        self._hurry(state, target, seconds)
        halts = bool(self.lost) or self._brakes
        brakes_s = min(gait_speed.needs_s(state.velocity), gait_speed.STOPS_WITHIN * self._gait.period_s)
        velocity = gait_speed.slewed(state, target, seconds, gait_speed.HALT_S if halts else brakes_s)
        if velocity.moves:
            velocity = velocity.times(self._begun(state, velocity) if began else self._allowed(state, velocity))
        state.velocity = velocity
        state.odometry = state.odometry.then(Odometry(*travelled(velocity, seconds)))
        for leg, foot in state.feet.items():
            if leg not in state.swings and leg not in self.lost:
                state.feet[leg] = carried(foot, velocity, seconds)
        waits = state.pause(gait.period_s, seconds)
        if (velocity.moves or state.swings) and not waits:
            state.clock = (state.clock + (0.0 if began else seconds / gait.period_s)) % 1.0
        for leg, swing in list(state.swings.items()):
            self._swing(state, leg, swing, seconds, felt.feet.get(leg))
        standing = [leg for leg in LEGS if leg not in state.swings]
        lifts = velocity.moves and not halts
        due = [leg for leg in standing if lifts and self._is_due(leg, state.clock)]
        stay = [leg for leg in standing if leg not in due]
        if due and len(stay) >= _LEAST_FEET and balanced(self.robot, state, stay):  # else those that are due wait
            state.swings.update({leg: Swing(state.feet[leg]) for leg in due})

    def _swing(self, state: State, leg: int, swing: Swing, seconds: float, touches: bool | None) -> None:
        """Move a foot from the line on which the ground carried it to the line on which it will land.

        `touches`: whether the foot is felt on the ground; None: unknown.
        """
        gait, velocity = self._quick, state.velocity
        left = carried(swing.left, velocity, seconds)
        part = min(swing.part + seconds / gait.swing_s, 1.0)
        across = transitions.across(part)
        if self._brakes or transitions.across(swing.part) == 1.0:  # it comes straight down
            x, y, _ = carried(state.feet[leg], velocity, seconds)
        else:
            rest, wide = self.stance.feet[leg], min(1.0, self.corrected_rad / WIDE_RAD)
            if wide:  # the more the body leans against its feet, the further out they rest
                rest = transitions.between(rest, self.robot.widened(self.stance.body)[leg], wide)
            state.rests[leg] = rest
            before_s = (1.0 - part) * gait.swing_s + (gait.stance_s + state.paused_s) / 2
            x, y, _ = transitions.between(left, carried(rest, velocity, -before_s), across)
        height_m = min(LIFT_M, swing.left[2] * (1.0 - across) + self._lift_m * transitions.up(part, self._climb))
        if self._brakes and part < 1.0:
            height_m = gait_speed.dropped(state.feet[leg][2], seconds)
            part = max(swing.part, 0.5) if height_m else 1.0
        if swing.met_now(touches) and not swing.met:
            state.lateness = state.lateness.after(swing.late_s or (part - 1.0) * gait.swing_s)
        state.feet[leg] = x, y, state.feet[leg][2]
        if state.lower(leg, swing._replace(left=left, part=part), height_m, touches, seconds):
            over = velocity if velocity.moves else self.commanded
            state.over = over if over.moves else state.over

    def _is_due(self, leg: int, clock: float) -> bool:
        return gaits.phase(self._quick, leg, clock + transitions.ALMOST) < (1 - self._quick.duty) / 2

    # ---- velocities

    def _hurry(self, state: State, target: Velocity, seconds: float) -> None:
        """Change the tempo towards the need of `target` and the present velocity. A walk that ends keeps its tempo."""
        now = state.velocity
        walks = now.moves or bool(state.swings)
        if target.moves or not walks:
            stride = max(self._stride_of(target), self._stride_of(now))
            state.tempo = gait_speed.towards(state.tempo, stride, self._least_tempo, seconds if walks else math.inf)
        self._quick, self._lift_m, self._climb = gait_speed.at_tempo(self._gait, state.tempo)

    def _stride_of(self, velocity: Velocity) -> float:
        """Return the longest stride at the gait's usual tempo, as a part of its disc."""
        if not velocity.moves:
            return 0.0
        half_s = self._gait.stance_s / 2
        rests = self.stance.feet.values()
        return max(math.dist(carried(rest, velocity, half_s), rest) for rest in rests) / self._within_m

    @property
    def _within_m(self) -> float:
        """Return how far (m) from its resting place a foot may stand."""
        return self.stance.radius_m / transitions.outward(self._gait.swing_s, self._gait.stance_s)

    def _allowed(self, state: State, velocity: Velocity) -> float:
        """Return the part (0 to 1) of this velocity that keeps each standing foot in its disc until it is lifted."""
        return largest(lambda part: self._stays(state, velocity.times(part)))

    def _begun(self, state: State, velocity: Velocity) -> float:
        """Return `_allowed` for a walk that begins. It first lifts the feet that would limit the velocity."""
        for state.clock in sorted({*self._quick.lifts}):
            if allowed := self._allowed(state, velocity):
                return allowed
        return 0.0

    def _stays(self, state: State, velocity: Velocity) -> bool:
        within_m = self._within_m + _LATE_M
        for leg, foot in state.feet.items():
            if leg in state.swings or leg in self.lost or self._is_due(leg, state.clock):
                continue
            rest = state.rests.get(leg, self.stance.feet[leg])
            left_s = (1.0 - gaits.phase(self._quick, leg, state.clock)) * self._quick.period_s
            if math.dist(carried(foot, velocity, left_s), rest) > max(within_m, math.dist(foot, rest)):
                return False
        return True

    def _report(self, target: Velocity, cap: float, pace: float, seconds: float, slowest: int) -> None:
        """Set `scaled` and `limit`. Servos are too slow only in moments of a stride: its mean counts."""
        self._pace += (pace - self._pace) * min(1.0, seconds / self._gait.period_s)
        self._slowest = slowest or self._slowest
        self.scaled = target.times(cap * self._pace)
        if self._barred or self.state.goes_over(self.commanded):
            legs = ", ".join(map(str, sorted(self.state.hanging)))
            self.limit = self._barred or f"no ground under leg {legs}: it hangs over an edge"
        elif not target.moves:
            self._pace, self.limit = 1.0, self.limit if self._stuck else ""
        elif self._pace < min(cap, gait_speed.SPEED_SPARE):
            self.limit = f"the speed of servo {self._slowest} allows {100 * cap * self._pace:.0f} % of it"
        elif cap < 1.0:
            self.limit = f"the legs' strides reach {100 * cap:.0f} % of it"
        else:
            self.limit = ""
