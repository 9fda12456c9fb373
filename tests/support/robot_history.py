"""The part of the oracle (`oracle.py`) that is about the whole robot, its body and its supply, and Stops at rest."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Self

from gateway.model.calibration import RobotCalibration
from gateway.model.frames import STOP, Frame, OneServo, Op, servo_ids_of, stop_leg
from gateway.robot.core.events import (
    BodyMeasured,
    ClearErrors,
    Command,
    Cut,
    Effect,
    EstopKept,
    Event,
    Feed,
    PowerSeen,
    StoppedOutside,
    Transmit,
)
from gateway.robot.core.rules import Rules
from schemas.robot import LEGS, SERVO_IDS
from schemas.words import Kind, Mode, Reason
from tests.support.calibration_history import CalibrationHistory
from tests.support.history import (
    CLOSED,
    LandingHistory,
    LegHistory,
    ServoHistory,
    cloned,
    demand,
    is_announced,
    stopped_by,
    supply_of,
)
from tests.support.request_history import BacklogHistory, ButtonsHistory, LeaseHistory


class BodyHistory:
    """Battery and body by the latest measurements."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.low = self.fallen = False
        self.unknown = rules.min_battery_mv > 0
        """Whether a battery with a limit was not measured yet: it may be empty."""
        self.tilted_ns: int | None = None
        """When the present tilt beyond the limit was first measured."""

    def key(self, now_ns: int) -> tuple[object, ...]:
        """Return what still matters."""
        age_ns = None if self.tilted_ns is None else min(now_ns - self.tilted_ns, self.rules.tilt_ns)
        return self.low, self.unknown, self.fallen, age_ns

    def judge(self, event: BodyMeasured | None, now_ns: int, effects: Sequence[Effect]) -> None:
        """Take a measurement (None: another event came), and judge what is announced of the body."""
        before = self.low, self.fallen
        if event is not None:
            self._take(event, now_ns)
        kinds = [is_announced(effects, kind) for kind in (Kind.BATTERY_LOW, Kind.FALLEN)]
        demand(kinds[0] == (self.low and not before[0]), "a battery is announced once when it becomes low")
        demand(kinds[1] == (self.fallen and not before[1]), "a fall is announced once")

    def _take(self, event: BodyMeasured, now_ns: int) -> None:
        limit_mv, self.unknown = self.rules.min_battery_mv, False
        if event.battery_mv < limit_mv:
            self.low = True
        elif event.battery_mv >= limit_mv + limit_mv // 50:
            self.low = False
        if event.tilt_cdeg is not None:
            beyond = 0 < self.rules.max_tilt_cdeg < event.tilt_cdeg
            if not beyond:
                self.tilted_ns, self.fallen = None, False
            elif self.tilted_ns is None:
                self.tilted_ns = now_ns
        if self.tilted_ns is not None and now_ns - self.tilted_ns >= self.rules.tilt_ns:
            self.fallen = True


class PowerHistory:
    """Supply: whether the power board answers, which servos it refuses, feeds and may feed."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.silent = rules.power
        """A board that has not answered yet feeds nothing."""
        self.blocked: frozenset[int] = frozenset()
        self.withheld: frozenset[int] = frozenset()
        """Servos that drew current, or that another program has switched off, until a reset."""
        self.trusted = rules.angles_first
        """Whether a fed servo was seen at rest since the last fault."""
        self.ordered: dict[int, int | None] = {}
        """The servos to feed since the latest step, each as in `to_feed`."""
        self.why: tuple[Mode, int] | None = None
        """The mode for which all supply is cut, with the number of the emergency stop."""
        self.is_cut = False
        self.fed: frozenset[int] = frozenset()
        """The servos that the board has confirmed to feed, of those that run or wait to be started since."""
        self.on = rules.power

    def key(self) -> tuple[object, ...]:
        """Return what still matters."""
        ordered = tuple(self.ordered.items())
        return self.silent, self.blocked, self.withheld, self.trusted, ordered, self.is_cut, self.fed

    @property
    def refused(self) -> frozenset[int]:
        return self.blocked | self.withheld

    def _deaf(self, seen: PowerSeen) -> bool:
        """Return whether the controller does not obey: the servo that is fed alone draws current."""
        return not (self.trusted or seen.rests) and any(servo_id in self.ordered for servo_id, _ in seen.drew)

    def doubts(self, seen: PowerSeen) -> bool:
        """Return whether a servo that should be off may be on."""
        unfed = any(servo_id not in self.ordered for servo_id, _ in seen.drew)
        return bool(seen.doubt) or unfed or self._deaf(seen)

    def take(self, event: Event) -> None:
        """Take a report of the board, if the event is one."""
        self.restored = False
        if isinstance(event, PowerSeen):
            self.silent, self.blocked = not event.alive, frozenset(servo_id for servo_id, _ in event.refused)
            drew = SERVO_IDS if self._deaf(event) else [servo_id for servo_id, _ in event.drew]
            self.withheld |= (event.taken - self.blocked).union(drew)
            self.trusted = self.trusted or event.rests
            if event.lost - event.taken - self.blocked:
                self.trusted = self.rules.angles_first
            self.fed = event.fed if self.trusted else frozenset()
            self.restored = self.is_cut and not event.supplied.isdisjoint(self.ordered)

    def judge(
        self,
        effects: Sequence[Effect],
        to_feed: Mapping[int, int | None],
        mode: Mode,
        estops: int,
        *,
        reset: bool,
        outside: bool,
    ) -> None:
        """Judge what a step cuts and feeds. `reset`: it was an accepted reset."""
        demand(self.on or not supply_of(effects), "without a board there is no supply to switch")
        if not self.on:
            return
        cuts = [each for each in effects if isinstance(each, Cut)]
        feeds = [each for each in effects if isinstance(each, Feed)]
        demand([*effects[: len(cuts)]] == cuts, "cuts precede all else")
        last = max((place for place, each in enumerate(effects) if isinstance(each, Transmit)), default=-1)
        demand(all(effects.index(each) > last for each in feeds), "nothing is fed before the step's frames")
        demand(any(isinstance(each, ClearErrors) for each in effects) == reset, "a reset alone clears errors")
        why = (mode, estops) if mode in (Mode.ESTOPPED, Mode.BUS_FAULT, Mode.STOPPING) else None
        kept, new = self.ordered.keys() & to_feed, why is not None and why != self.why
        cut = [Cut(frozenset(kept), new)] if new or kept != self.ordered.keys() else []
        demand(cuts == cut, f"the step cuts {cut}, not {cuts}")
        ends = bool(why and self.ordered)
        demand(is_announced(effects, Kind.POWER_CUT) == ends, "a cut of what was fed is announced")
        demand(is_announced(effects, Kind.POWER_RESTORED) == self.restored, "supply after a cut is announced")
        self.is_cut = (self.is_cut and not self.restored) or ends
        self.withheld = (frozenset() if reset else self.withheld).union(self.ordered if outside else ())
        if why or outside or self.silent:
            self.trusted = self.rules.angles_first
        may = to_feed.keys() - self.refused
        ordered = dict(feeds[-1].servos) if feeds else self.ordered
        demand(ordered.items() <= to_feed.items() and ordered.keys() <= may, f"{ordered} is fed, of {may} that may be")
        most = may if self.trusted else may & kept
        demand(ordered.keys() == most or (not most and len(ordered) == bool(may)), f"{ordered} is fed, of {may}")
        demand(bool(feeds) == (ordered != self.ordered), "what is fed is stated when it changes")
        self.ordered, self.why = ordered, why

    def reason_to_reject(self, moved: Collection[int]) -> Reason | None:
        """Return why these servos may neither start nor move, or None."""
        return Reason.NO_POWER if self.silent or not self.refused.isdisjoint(moved) else None

    def after(self, alive: Collection[int], *, lands: bool) -> None:
        """Judge what runs, or waits to be started, at the end of a step."""
        self.fed &= frozenset(alive)
        demand(lands or not self.silent or not alive, "nothing runs while the power board does not answer")
        demand(lands or self.refused.isdisjoint(alive), "nothing runs that the power board refuses to feed")


class RobotHistory:
    """The requests to one robot and the frames to it. `legs` are all its legs."""

    _lost: frozenset[int] = frozenset()
    """Commands of which the watchdog dropped something in this step."""

    def __init__(
        self,
        rules: Rules,
        legs: Iterable[int] = LEGS,
        calibration: RobotCalibration | None = None,
        fault: str | None = None,
    ) -> None:
        self.rules = rules
        self.legs = {leg: LegHistory() for leg in legs}
        self.servos = {servo_id: ServoHistory() for leg in self.legs for servo_id in servo_ids_of(leg)}
        self.pending: dict[int, bool] = {}
        """Accepted commands without an answer, and whether a newer one has replaced something of them."""
        self.opened = self.bus_ok = self.ended = self.outside = False
        self.estops = 0
        self.latched_ns: int | None = None
        self.unknown = rules.estop_kept
        """Whether an earlier run may have left an emergency stop engaged."""
        self.disk = 0, False
        """The number of the latest emergency stop that the disk has, and whether it has it as engaged."""
        self.instant_ns = 0
        """When the present instant began: that of all that was collected together."""
        self.lease = LeaseHistory(rules)
        self.buttons = ButtonsHistory(rules)
        self.body = BodyHistory(rules)
        self.power = PowerHistory(rules)
        self.backlog = BacklogHistory(rules)
        self.fault = Kind.BUS_FAULT
        """The latest fault of the bus."""
        self.calibration = CalibrationHistory(rules, calibration or RobotCalibration(), fault)
        self.landing: LandingHistory | None = None
        self.energised_leg: int | None = None
        self.energised_ns = 0
        self.rest_ns: int | None = None
        """When the legs at rest must get a Stop; None: no Stop is owed."""
        self.runs_left = 0
        """How many more runs of Stops are owed while nothing runs."""
        self.settled_ns = 0
        """From when a run counts as one of these: long enough after the last Stop and its repeats."""
        self.owing: list[ServoHistory] = []
        """The servos that get a first Stop in this step."""
        self.sent_again: list[Frame] = []
        """This step's repeated frames: a second equal frame belongs to a run for legs at rest."""
        self.together = False
        """Whether all repeats may go with one that is due, since nothing runs."""
        self.put_off = False
        """Whether the repeats that are due may wait for the next step, since this one stops all legs."""

    # ---- for the model checker

    def clone(self) -> Self:
        """Return a copy that shares nothing that changes."""
        return cloned(
            self,
            legs={number: cloned(leg) for number, leg in self.legs.items()},
            servos={servo_id: cloned(servo) for servo_id, servo in self.servos.items()},
            pending=dict(self.pending),
            landing=self.landing and cloned(self.landing, parts_ns=dict(self.landing.parts_ns)),
            lease=cloned(self.lease),
            calibration=cloned(self.calibration),
            buttons=cloned(self.buttons, known=dict(self.buttons.known)),
            body=cloned(self.body),
            power=cloned(self.power),
            backlog=self.backlog.clone(),
        )

    def key(self, now_ns: int, rank: dict[int, int]) -> tuple[object, ...]:
        """Return what of the history still matters, relative to now; `rank` numbers the pending commands by age."""
        legs = tuple(leg.key(now_ns, self.rules, armed=self.armed(number)) for number, leg in self.legs.items())
        servos = tuple(servo.key(now_ns, self.instant_ns, rank, self.rules) for servo in self.servos.values())
        oldest_ns = self.rules.unnumbered_reset_ns
        # How old the latest emergency stop is for a reset of this instant, and of one that begins now.
        since_ns = () if self.latched_ns is None else (self.instant_ns - self.latched_ns, now_ns - self.latched_ns)
        pause = (self.energised_leg, min(now_ns - self.energised_ns, self.rules.start_pause_ns))
        if not self.rules.start_pause_ns:
            pause = (None, 0)
        pending = tuple(self.pending[number] for number in sorted(self.pending))
        others = self.lease.key(now_ns), self.buttons.key(now_ns), self.body.key(now_ns), self.calibration.key()
        landing = self.landing and self.landing.key(now_ns)
        return (
            self.opened,
            self.bus_ok,
            self.fault,
            self.ended,
            self.outside,
            tuple(min(each_ns, oldest_ns) for each_ns in since_ns),
            self.unknown,
            self.rules.estop_kept and (self.disk[1], self.disk == (self.estops, self.latched_ns is not None)),
            pause,
            pending,
            legs,
            servos,
            landing,
            others,
            self.power.key(),
            self.backlog.key(now_ns, [each for each, servo in self.servos.items() if servo.starts and not servo.on]),
            self.bus_ok and self.rest_ns and max(0, self.rest_ns - now_ns),
            self.bus_ok and self.runs_left and (self.runs_left, max(0, self.settled_ns - now_ns)),
        )

    # ---- what follows from that

    def armed(self, leg: int) -> bool:
        return any(servo.on or servo.starts for servo in self.servos_of(leg))

    def runs(self, leg: int) -> bool:
        return any(servo.on for servo in self.servos_of(leg))

    def servos_of(self, leg: int) -> list[ServoHistory]:
        return [self.servos[servo_id] for servo_id in servo_ids_of(leg)]

    def held(self, leg: int) -> list[int]:
        """Return the servos of a leg whose starts wait for supply: a command starts all its servos together."""
        starting = {
            each: servo.want for each, servo in self.servos.items() if servo.want and servo.starts and not servo.on
        }
        unfed = {want.number for each, want in starting.items() if self.power.on and each not in self.power.fed}
        return [each for each in servo_ids_of(leg) if each in starting and starting[each].number in unfed]

    @property
    def energised(self) -> frozenset[int]:
        """Return the servos that the frames so far have energised."""
        return frozenset(servo_id for servo_id, servo in self.servos.items() if servo.on)

    @property
    def mode(self) -> Mode:
        """Return the mode that the gateway must report."""
        if self.ended:
            return Mode.STOPPING
        if not self.bus_ok:
            return Mode.BUS_FAULT if self.opened else Mode.STARTING
        if self.latched_ns is not None or self.unknown:
            return Mode.ESTOPPED
        return Mode.ACTIVE if self.energised else Mode.IDLE

    @property
    def alive(self) -> frozenset[int]:
        """Return the servos that run or wait to be started."""
        return frozenset(servo_id for servo_id, servo in self.servos.items() if servo.on or servo.starts)

    def to_feed(self) -> dict[int, int | None]:
        """Return the servos that run (None), and those that wait to start: their wire angle for a start by supply."""
        found: dict[int, int | None] = {}
        for servo_id, servo in self.servos.items() if self.bus_ok else ():
            if servo.on:
                found[servo_id] = None
            elif servo.want is not None and not self.gated(servo_id):
                known = servo.want.angle_cdeg if servo.want.from_cdeg is None else servo.want.from_cdeg
                found[servo_id] = self.calibration.wire_cdeg(servo_id, known)
        return found

    # ---- what is taken

    def learn(self, event: EstopKept | StoppedOutside) -> None:
        """Take what an earlier run has left, or the end of `stop-servos`."""
        if isinstance(event, StoppedOutside):
            self.outside = False
            return
        self.unknown, self.estops = False, self.estops + event.number
        if event.engaged and self.latched_ns is None:
            self.latched_ns = self.instant_ns

    def reason_to_reject(self, command: Command) -> Reason | None:
        """Return why a command must be rejected, or None."""
        closed = CLOSED.get(self.mode)
        moves = [(self.servos[servo_id], servo_id, op) for servo_id, op in command.targets if op.op is not Op.STOP]
        if moves:
            closed = closed or self.reason_to_move_nothing(command.lease) or self.too_few_buttons
            needs_battery = any(not servo.on and not servo.starts for servo, _, _ in moves)
            unfit = Reason.BATTERY_LOW if (self.body.low or self.body.unknown) and needs_battery else None
            closed = closed or (Reason.FALLEN if self.body.fallen else unfit)
            moved = [servo_id for _, servo_id, _ in moves]
            closed = closed or self.power.reason_to_reject(moved) or self.calibration.reason_to_reject(moved)
        if closed is not None:
            return closed
        if not all(self.calibration.allows(servo_id, op.angle_cdeg) for _, servo_id, op in moves):
            return Reason.JOINT_LIMIT
        for servo, _, op in moves:
            if servo.stopped_ns == self.instant_ns and servo.stopped_by - {command.channel}:
                return Reason.SERVO_STOPPED
            if op.op is Op.SET and not servo.on and not servo.starts:
                return Reason.SERVO_STOPPED
        partly = 0 < len(moves) == len(command.targets) < len(self.servos)
        if self.rules.starts_whole and partly and not self.alive:
            return Reason.WHOLE_ROBOT
        return None

    def reason_to_move_nothing(self, lease: str | None) -> Reason | None:
        if self.outside:
            return Reason.SERVO_STOPPED
        return self.lease.reason_to_reject(lease) or (None if self.landing is None else Reason.LANDING)

    @property
    def too_few_buttons(self) -> Reason | None:
        """Return why no start, set or reset is taken, if fewer buttons are alive than are required."""
        return Reason.NO_BUTTON if self.buttons.closed else None

    def _lose(self, numbers: set[int]) -> None:
        """Drop the commands with these numbers: each is rejected as a whole."""
        self._lost |= numbers
        for servo in self.servos.values():
            servo.want = None if servo.want is not None and servo.want.number in self._lost else servo.want

    def forget_angles(self, *, changed: bool) -> None:
        """Forget where servos stood, if the calibration `changed` or the bus is back."""
        for servo in self.servos.values() if changed else ():
            servo.stood_cdeg = None

    # ---- frames

    def named(self, transmit: Transmit, command: int) -> None:
        """Demand that a frame names the commands that it carries out: if it fails, their answers name its leg."""
        ready, stops = self.ungated(transmit.frame.leg), transmit.frame.is_stop
        says = [each for each, op in transmit.frame.servos if stops or (each in ready and op is not STOP)]
        wants = {want.number for servo_id in says if (want := self.servos[servo_id].want)}
        named = {each.number for each in transmit.commands}
        demand(named >= {each.number for each in transmit.done}, "a frame completes what it carries out, if anything")
        its = {command} if command else set[int]()
        demand(wants <= named <= wants | its, f"a frame of commands {wants} names {named}")
        demand(named == {command} or not transmit.frame.is_stop, f"a Stop of command {command} names {named}")

    def repeated(self, transmit: Transmit, now_ns: int) -> list[Transmit]:
        """Take a Stop without a command. Return it if it repeats no other: then it must be for a leg at rest."""
        demand(transmit.frame.is_stop, "only Stops are repeated")
        servos = [self.servos[servo_id] for servo_id, _ in transmit.frame.servos]
        for servo_id, _ in transmit.frame.servos:
            demand(not self.servos[servo_id].on, f"{servo_id} runs: its Stops are not repeated any more")
        first = [any(each is servo for each in self.owing) for servo in servos]
        owed = all(
            servo.owed > 0 and (servo.owed_ns <= now_ns or (self.together and not is_first))
            for servo, is_first in zip(servos, first, strict=True)
        )
        owed = owed and transmit.frame not in self.sent_again
        if transmit.joins or not owed:
            return [transmit]
        self.sent_again.append(transmit.frame)
        for servo, is_first in zip(servos, first, strict=True):
            servo.owed -= not is_first
            servo.owed_ns = now_ns + self.rules.repeat_interval_ns
        return []

    # ---- legs at rest

    def owe(self, servos: Iterable[ServoHistory], now_ns: int) -> None:
        """Record a Stop to these servos, which is to be repeated."""
        for servo in servos:
            servo.owe(self.rules, now_ns)
            self.owing.append(servo)

    @property
    def resting(self) -> list[int]:
        """Return the legs of which no servo runs or waits to be started."""
        return [number for number in self.legs if not self.armed(number)]

    def rest(
        self, effects: Sequence[Effect], unowed: Sequence[Transmit], now_ns: int, *, ran: bool, silent: bool
    ) -> None:
        """Judge the Stops that neither a command nor an earlier Stop explains (`unowed`), at the end of a step.

        `ran`: something ran before it; `silent`: the watchdog stops a leg in it.
        """
        came = ran and not self.energised
        at_once = silent or came
        expected: list[tuple[Frame, bool]] = []
        stopped = stopped_by(effect for effect in effects if effect not in unowed)
        started = not ran and bool(self.energised)
        due = self.rest_ns is not None and now_ns >= self.rest_ns and not started
        if (at_once or due) and self.resting:
            final = False
            if due and not ran and now_ns >= self.settled_ns:
                self.runs_left -= 1
                final = self.runs_left == 0
            if due or ran:
                self.rest_ns = None
            for number in self.resting:
                servos = servo_ids_of(number)
                alone = any(not self.servos[each].owed and each not in stopped for each in servos)
                if alone:
                    whole = stop_leg(number)
                    singly: list[Frame] = [OneServo(each, STOP) for each in servos]
                    # The last run has a call and a preamble of its own.
                    expected += [(frame, False) for frame in singly] if final else [(whole, at_once)]
                if came or (alone and at_once):
                    self.owe(self.servos_of(number), now_ns)
        found = [(transmit.frame, transmit.joins) for transmit in unowed]
        for frame, joins in found:
            demand((frame, joins) in expected, f"a Stop to {frame.servos[0][0]} that nobody owes")
        demand(found == expected, f"legs at rest get a Stop each: {expected}, not {found}")
        last = [effect.joins for effect in effects if isinstance(effect, Transmit) and effect.frame.is_stop]
        demand(last == sorted(last), "Stops to legs at rest come after all others")

    def next_rest(self, now_ns: int, *, ran: bool) -> list[int]:
        """Return when legs at rest get their next Stop: while others run, and for a while after the last Stop."""
        if self.energised:
            self.runs_left = 0
            if self.rest_ns is None or not ran:
                self.rest_ns = now_ns + self.rules.rest_ns
        else:
            if self.owing:
                more = not self.ended and self.rules.rest_runs > 0
                self.runs_left = self.rules.rest_runs + 1 if more else 0
                repeated_ns = now_ns + self.rules.repeats * self.rules.repeat_interval_ns
                self.settled_ns = repeated_ns + self.rules.rest_run_ns
            if not self.runs_left:
                self.rest_ns = None
            elif self.rest_ns is None:
                self.rest_ns = max(self.settled_ns, now_ns + self.rules.rest_run_ns)
        if self.rest_ns is None or not self.resting:
            return []
        demand(now_ns < self.rest_ns, "legs at rest get a Stop in time")
        return [self.rest_ns]

    # ---- starts without a time

    def ungated(self, leg: int) -> list[int]:
        """Return the servos of a leg whose starts, if any, wait for their rate slot only."""
        held = self.held(leg)
        return [each for each in servo_ids_of(leg) if each not in held and not self.gated(each)]

    def gated(self, servo_id: int) -> bool:
        """Return whether a servo's start waits for messages that may come after it."""
        servo = self.servos[servo_id]
        return servo.starts and not servo.on and servo_id in self.backlog.waiting_ns

    def hold_starts(self, command: Command, now_ns: int) -> None:
        """Let the starts of an accepted command wait for messages that may come after them."""
        named = [servo_id for servo_id, op in command.targets if op.op is not Op.STOP]
        for servo_id in self.servos if self.rules.starts_whole and named else named:
            servo = self.servos[servo_id]
            if not servo.on:
                self.backlog.begins(servo_id, command, now_ns, waits=servo.starts)

    def judge_starts(self, now_ns: int) -> None:
        """Let the starts whose wait is over leave, or be rejected."""
        backlogs: set[int] = set()
        for servo_id, servo in self.servos.items():
            verdict = self.backlog.verdict(servo_id, now_ns) if self.gated(servo_id) else None
            if isinstance(verdict, bool):
                del self.backlog.waiting_ns[servo_id]
                backlogs |= {servo.want.number} if servo.want is not None and not verdict else set()
        self._lose(backlogs)

    # ---- starts one after the other

    def energise(self, leg: int, now_ns: int) -> None:
        if self.energised_leg not in (None, leg):
            demand(now_ns - self.energised_ns >= self.rules.start_pause_ns, "two legs are energised with a pause")
        self.energised_leg, self.energised_ns = leg, now_ns

    def queue_ended(self, event: object) -> None:
        """Demand that a Stop has ended all starts that waited: nobody wants one a moment later."""
        own = event.number if isinstance(event, Command) else None
        for servo in self.servos.values():
            waits = servo.want is not None and servo.want.number != own and servo.starts and not servo.on
            demand(not waits, "with staggered starts, a Stop ends what waits to be energised")

    def next_start(self, now_ns: int) -> list[int]:
        """Return when the next leg must start at the latest, with staggered starts."""
        starting = [
            leg.slot_ns(self.rules.period_ns)
            for number, leg in self.legs.items()
            if any(self.servos[each].starts and not self.servos[each].on for each in self.ungated(number))
        ]
        if not starting or not self.rules.start_pause_ns:
            return []
        pause_ns = 0 if self.energised_leg is None else self.energised_ns + self.rules.start_pause_ns
        slot_ns = max(min(starting), pause_ns)
        demand(now_ns < slot_ns, "a leg that waits is energised when the pause is over")
        return [slot_ns]
