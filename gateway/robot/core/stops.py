"""Which Stops are owed: one schedule for all servos that are to be off. Pure; time is an argument.

Nothing acknowledges a frame, and a controller that lost bytes may run a servo that nobody started. So a servo gets

1. its first Stop, in the step that stops it;
2. `Rules.repeats` more, `repeat_interval_ns` apart. While nothing runs, all pending ones leave with the first: one
   preamble;
3. with its leg at rest, a Stop with every *round*: each `rest_ns` while other legs run; while nothing runs,
   `rest_runs` times `rest_run_ns` apart after the last repeat, and once more with a frame for each servo, which lost
   bytes cannot turn into a start.

A Stop that leaves nothing running, and one for a silent leg, begin 2 for all legs at rest. A frame that moves a servo
ends its repeats. A set time is not postponed, since it could be postponed forever.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gateway.model.frames import STOP, OneServo, stop_leg
from gateway.robot.core.events import Command, Transmit
from gateway.robot.core.leg import Leg
from gateway.robot.core.rules import Rules
from gateway.robot.core.servo import Servo
from schemas.words import Cause


def stops(
    leg: Leg,
    servos: Sequence[Servo],
    cause: Cause,
    *,
    commands: tuple[Command, ...] = (),
    deadline_ns: int | None = None,
    joins: bool = False,
    singly: bool = False,
) -> list[Transmit]:
    """Return Stops for these servos of a leg: one frame for all three, else, or `singly`, one for each."""
    if len(servos) == len(leg.servos) and not singly:
        return [Transmit(stop_leg(leg.number), cause, deadline_ns, commands, joins=joins)]
    return [Transmit(OneServo(servo.servo_id, STOP), cause, deadline_ns, commands) for servo in servos]


@dataclass(slots=True)
class Repeats:
    """The repeats owed to one servo."""

    left: int = 0
    due_ns: int = 0  # mutants accepted (Step): the first Stop sets it


class StopSchedule:
    """The Stops that are owed, by repeats of each servo and by rounds of all legs at rest."""

    def __init__(self, rules: Rules, legs: Iterable[Leg]) -> None:  # mutants accepted (Step): the first Stop sets both
        self._rules = rules
        self._legs = legs
        self._repeats = {servo.servo_id: Repeats() for leg in legs for servo in leg.servos}
        self._round_ns: int | None = None
        """When legs at rest get their next Stop, or None."""
        self._settled_ns = 0
        """When runs begin to count, after the last Stop and its repeats."""
        self._runs_left = 0
        self.runs = rules.rest_runs + 1 if rules.rest_runs else 0
        """The number of rounds after a Stop while nothing runs; 0 once the service ends, which waits for none."""
        self.due_ns: int | None = None
        """When the next repeat or round is due; as of the last `plan`."""

    def begin(self) -> None:
        """Begin a step."""
        self.sent: set[int] = set()
        """The servos that get a Stop in this step."""
        self._first: set[int] = set()
        self.silent = False
        """Whether the watchdog stops a leg in this step."""

    # ---- what happens to a servo

    def first(self, servos: Iterable[Servo], now_ns: int) -> None:
        """Record first Stops, and owe their repeats. A repeat that is pending keeps its time."""
        for servo in servos:
            repeats = self._repeats[servo.servo_id]
            if not repeats.left:
                repeats.due_ns = now_ns + self._rules.repeat_interval_ns
            repeats.left = self._rules.repeats
            self._first.add(servo.servo_id)
            self.sent.add(servo.servo_id)

    def started(self, servo_id: int) -> None:
        """End a servo's repeats: they would undo its start."""
        self._repeats[servo_id].left = 0

    def repeats(self, servo_id: int) -> int:
        """Return how many repeats are owed to a servo."""
        return self._repeats[servo_id].left

    def forget(self) -> None:
        """Cancel all Stops after a bus fault. The next opening of the bus stops all legs."""
        self._round_ns, self._runs_left = None, 0
        for repeats in self._repeats.values():
            repeats.left = 0

    # ---- what leaves

    def repeat(self, now_ns: int, *, at_rest: bool) -> list[Transmit]:
        """Return the repeats that are due. `at_rest`: nothing ran before this step."""
        owed = {servo_id: each for servo_id, each in self._repeats.items() if each.left}
        due = {servo_id for servo_id, each in owed.items() if now_ns >= each.due_ns}
        if due and at_rest:
            due |= owed.keys() - self._first
        for servo_id in due:
            repeats = owed[servo_id]
            repeats.left -= servo_id not in self.sent  # after a first Stop of this step, all are left
            repeats.due_ns = now_ns + self._rules.repeat_interval_ns
        self.sent |= due
        by_leg = ((leg, [each for each in leg.servos if each.servo_id in due]) for leg in self._legs) if due else ()
        return [stop for leg, servos in by_leg for stop in stops(leg, servos, Cause.REPEAT)]

    # mutants accepted (AddNot, AndWithOr, Delete_Not): the longer way finds nothing; no runs are left while legs run
    def round(self, now_ns: int, *, ran: bool, runs: bool) -> list[Transmit]:
        """Return the Stops for legs at rest. Call it at the end of a step.

        `ran`: a servo ran before this step; `runs`: one runs now. A leg with a Stop in this step, or with pending
        repeats, gets no other.
        """
        if not self.silent and not self.sent and (self._round_ns is None or now_ns < self._round_ns):
            return []
        ends = ran and not runs and bool(self.sent)
        if ends and len(self._first) == len(self._repeats):
            self._round_ns = None  # this step has stopped all six legs, so no leg needs another Stop
            return []
        at_once = ends or self.silent
        due = self._round_ns is not None and now_ns >= self._round_ns and (ran or not runs)  # a start ends the runs
        resting = [leg for leg in self._legs if not leg.armed] if at_once or due else []
        last = bool(resting) and (due or ran) and self._take_round(now_ns, is_run=due and not ran)
        found: list[Transmit] = []
        for leg in resting:
            stopped = all(each.servo_id in self.sent or self._repeats[each.servo_id].left for each in leg.servos)
            if not stopped:
                found += stops(leg, leg.servos, Cause.REPEAT, joins=at_once, singly=last)
                self.sent |= {servo.servo_id for servo in leg.servos}
            if ends or (at_once and not stopped):
                self.first(leg.servos, now_ns)
        return found

    def _take_round(self, now_ns: int, *, is_run: bool) -> bool:
        """Record a round that leaves now; `is_run`: nothing runs. Return whether it is the last one."""
        self._round_ns = None
        if not is_run or now_ns < self._settled_ns:
            return False
        self._runs_left -= 1
        return self._runs_left == 0

    # ---- when

    def plan(self, now_ns: int, *, ran: bool, runs: bool, rests: bool) -> None:
        """Set the next times at the end of a step. `rests`: a leg is at rest."""
        if not runs or not ran or self._round_ns is None:
            self._plan_round(now_ns, runs=runs)
        times = [each.due_ns for each in self._repeats.values() if each.left]
        if rests and self._round_ns is not None:
            times.append(self._round_ns)
        self.due_ns = min(times) if times else None

    # mutants accepted (Step): the next Stop sets the runs anew
    def _plan_round(self, now_ns: int, *, runs: bool) -> None:
        """A leg that starts ends the runs and begins the rounds."""
        rules = self._rules
        if runs:
            self._runs_left, self._round_ns = 0, now_ns + rules.rest_ns
            return
        if self._first:
            settle_ns = rules.repeats * rules.repeat_interval_ns + rules.rest_run_ns
            self._runs_left, self._settled_ns = self.runs, now_ns + settle_ns
        if not self._runs_left:
            self._round_ns = None
        elif self._round_ns is None:
            self._round_ns = max(self._settled_ns, now_ns + rules.rest_run_ns)
