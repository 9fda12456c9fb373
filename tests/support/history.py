"""The part of the oracle (`oracle.py`) that is about servos and legs: what they did, and how they may move."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

from gateway.model.frames import Frame, Op, ServoOp, frame_of
from gateway.rate_limit import NS_PER_S
from gateway.robot.core import events
from gateway.robot.core.events import Transmit
from gateway.robot.core.rules import Rules
from schemas.words import Cause, Kind, Mode, Reason

CLOSED = {Mode.STOPPING: Reason.STOPPING, Mode.BUS_FAULT: Reason.BUS_FAULT, Mode.ESTOPPED: Reason.ESTOPPED}
"""The modes in which every command is rejected, each with the reason."""
NOBODY = "somebody without a name"
T = TypeVar("T")
STOP_SERVOS = {
    "stop-servos at work": events.StoppedOutside(at_work=True),
    "stop-servos ended": events.StoppedOutside(at_work=False),
}


class Violation(AssertionError):  # noqa: N818  (the model checker's word for it)
    """The supervisor broke a promise."""


def demand(condition: bool, promise: str) -> None:
    """Raise Violation with this promise unless the condition holds."""
    if not condition:
        raise Violation(promise)


def frames_of(targets: events.Targets) -> tuple[Frame, ...]:
    """Return a command's frames as the reader of its payload makes them: none if it stops a servo."""
    by_leg = events.Command(targets).by_leg.values()
    usual = all(op.op is not Op.STOP for _, op in targets) and all(len(each) in (1, 3) for each in by_leg)
    return tuple(map(frame_of, by_leg)) if usual else ()


def is_announced(effects: Iterable[events.Effect], kind: Kind) -> bool:
    """Return whether an event of this kind is announced."""
    return any(isinstance(effect, events.Announce) and effect.kind is kind for effect in effects)


def announced(effects: Iterable[events.Effect], kinds: Collection[Kind]) -> list[events.Announce]:
    """Return the announced events of these kinds."""
    return [effect for effect in effects if isinstance(effect, events.Announce) and effect.kind in kinds]


def judge_halts(
    effects: Sequence[events.Effect], halted: Sequence[events.Announce], stopped: Set[int], ended: Set[int]
) -> None:
    """Demand that first Stops of the servos in `stopped` are announced with their cause, and of none but `ended`."""
    written = {
        (effect.cause, servo_id)
        for effect in effects
        if isinstance(effect, events.Transmit) and effect.cause is not Cause.REPEAT
        for servo_id, op in effect.frame.servos
        if op.op is Op.STOP and servo_id in ended
    }
    told = [(each.cause, leg) for each in halted for leg in each.legs]
    named = {servo_id // 10 for cause, servo_id in written if (cause, servo_id // 10) in told}
    legs = {servo_id // 10 for _, servo_id in written if servo_id in stopped}  # a second cause finds it stopped
    demand(legs <= named, f"not as announced: {written}, {told}")
    demand({leg for _, leg in told} <= {each // 10 for each in ended}, f"not stopped, and announced: {told}")
    causes = [(each.cause, each.source, each.source_id) for each in halted]
    demand(len(set(causes)) == len(causes) and all(each.legs for each in halted), f"once for each cause: {causes}")


def spelled_out(effects: Iterable[events.Effect]) -> Iterator[events.Effect]:
    """Yield the effects, and after each frame the commands that it completes."""
    for effect in effects:
        yield effect
        if isinstance(effect, events.Transmit):
            yield from map(events.Completed, effect.done)


def supply_of(effects: Iterable[events.Effect]) -> list[events.Effect]:
    """Return the effects that are for the power board."""
    return [each for each in effects if isinstance(each, events.Cut | events.Feed | events.ClearErrors)]


def stopped_by(effects: Iterable[events.Effect]) -> set[int]:
    """Return the servos that the Stops among the frames name."""
    stops = [each.frame for each in effects if isinstance(each, events.Transmit) and each.frame.is_stop]
    return {servo_id for stop in stops for servo_id, _ in stop.servos}


def is_coalesced(request: events.Request) -> bool:
    """Return whether a newer command has replaced a part of this one."""
    return isinstance(request, events.Command) and request.coalesced


def rejections_of(number: int, effects: Iterable[events.Effect]) -> list[Reason]:
    """Return the reasons for which the command with this number is rejected: one at most, if all is well."""
    return [
        effect.reason for effect in effects if isinstance(effect, events.Rejected) and effect.request.number == number
    ]


def is_newer(reset: events.Reset, age_ns: int, estops: int, rules: Rules) -> bool:
    """Return whether a reset was certainly sent after the latest emergency stop, which is `age_ns` old."""
    if reset.estop is None:
        return age_ns >= rules.unnumbered_reset_ns
    return reset.estop == estops and age_ns > 0


def judge_results(effects: Sequence[events.Effect]) -> None:
    """Judge a step's answers if all its frames are written, if one fails, and if all do. Raise Violation."""
    undisturbed = events.results(effects)
    if not undisturbed:
        return
    requests = [request for request, _, _ in undisturbed]
    demand(len({id(each) for each in requests}) == len(requests), "a request is answered once")
    frames = [effect for effect in effects if isinstance(effect, events.Transmit)]
    for failed in (frames, *([each] for each in frames)):
        carried = {id(command) for frame in failed for command in frame.commands}
        disturbed = events.results(effects, failed, "a test's fault")
        demand([each for each, _, _ in disturbed] == requests, "a fault changes verdicts, and no order")
        for (request, before, _), (_, verdict, why) in zip(undisturbed, disturbed, strict=True):
            fails = id(request) in carried and not isinstance(before, Reason)
            expected = Reason.BUS_FAULT if fails else before
            demand(verdict == expected, f"of failed frames: {expected} and not {verdict} for request {request.number}")
            demand(bool(why) == isinstance(verdict, Reason), "a rejection has its sentence, and nothing else has one")


def judge_answer(
    request: events.LeaseRequest | events.ButtonRequest,
    effects: Iterable[events.Effect],
    reason: Reason | None,
    token: str | None,
) -> None:
    """Demand one answer to a request, with this reason for a rejection (None: it is granted, with this token)."""
    answers = [effect for effect in effects if isinstance(effect, events.RequestAnswer)]
    demand([each.reason for each in answers] == [reason], f"{request.do} is answered with {reason}, not {answers}")
    token = token if reason is None else None
    demand(answers[0].token == token, "only who acquires the lease or registers receives the token")


def cloned(thing: T, **changed: object) -> T:
    """Return a copy with these attributes changed; copy.copy takes four times as long."""
    other = object.__new__(type(thing))
    other.__dict__.update(thing.__dict__, **changed)
    return other


class Want(NamedTuple):
    """A servo's target from an accepted command that no frame has carried out yet."""

    op: Op
    angle_cdeg: int
    number: int
    from_cdeg: int | None = None
    """The known angle at which a start begins, as of its first command; None: it begins at its newest target."""


def numbered(effect: events.Effect) -> object:
    """Return an effect in which requests are replaced by their numbers, so that two runs can be compared."""
    match effect:
        case events.Transmit():
            numbers = [[each.number for each in named] for named in (effect.commands, effect.done)]
            return replace(effect, commands=(), done=()), numbers
        case events.Completed():
            return effect.request.number, is_coalesced(effect.request)
        case events.Rejected():
            return effect.request.number, effect.reason, effect.detail
    return effect


def speed_age_ns(since_ns: int, now_ns: int, rules: Rules) -> int | None:
    """Return how long ago that was, at most the time for 180 degrees: more makes no difference. None: no limit."""
    speeds = [*rules.max_speed_cdeg_s.values(), *([rules.takeover_cdeg_s] if rules.takeover_cdeg_s else [])]
    return min(now_ns - since_ns, 180_00 * NS_PER_S // min(speeds) + 1) if speeds else None


@dataclass
class ServoHistory:
    """One servo: the angle last written while it is energised, its pending target, and the Stops owed to it."""

    written_cdeg: int | None = None
    want: Want | None = None
    bound_cdeg: int | None = None
    """The target on the way to which it is, with a limited speed."""
    bound_for: int = 0
    """The number of the command with that target."""
    said_ns: int = 0
    """When a frame last moved it."""
    source: str | None = None
    """Who started or set it last."""
    eases: bool = False
    """Whether it is still on its way since another source commanded it, or since its start at a known angle."""
    stood_cdeg: int | None = None
    """Its angle when it was stopped; None: unknown."""
    stood_ns: int = 0
    edge_ns: int | None = None
    """Since when it crosses angles that are never sent."""
    owed: int = 0
    owed_ns: int = 0
    stopped_ns: int | None = None
    stopped_by: frozenset[str] = frozenset()

    def key(self, now_ns: int, instant_ns: int, rank: dict[int, int], rules: Rules) -> tuple[object, ...]:
        """Return what still matters; see `RobotHistory.key`."""
        return (
            self.written_cdeg,
            self.want and (self.want.op, self.want.angle_cdeg, self.want.from_cdeg, rank[self.want.number]),
            None if self.bound_cdeg is None else (self.bound_cdeg, rank.get(self.bound_for)),
            speed_age_ns(self.said_ns, now_ns, rules) if self.on else None,
            speed_age_ns(self.edge_ns, now_ns, rules) if self.on and self.edge_ns is not None else None,
            self.owed and (self.owed, max(0, self.owed_ns - now_ns)),
            self.stopped_by if self.stopped_ns == instant_ns else None,
            rules.takeover_cdeg_s and (self.source, self.eases, self.on or self.stands(now_ns, rules)),
            rules.takeover_cdeg_s and not self.on and min(now_ns - self.stood_ns, rules.takeover_known_ns + 1),
        )

    def rest(self, now_ns: int) -> None:
        """Record that a Stop was written."""
        if self.written_cdeg is not None:
            self.stood_cdeg, self.stood_ns = self.written_cdeg, now_ns
        self.written_cdeg, self.eases = None, False

    def stands(self, now_ns: int, rules: Rules) -> int | None:
        """Return its angle, or None if it is unknown."""
        if self.on:
            return self.written_cdeg
        known = rules.takeover_cdeg_s and now_ns - self.stood_ns <= rules.takeover_known_ns
        return self.stood_cdeg if known else None

    def wants(self, command: events.Command, op: ServoOp, moved_ns: int | None, now_ns: int, rules: Rules) -> None:
        """Take the target of an accepted command; a frame last moved its leg at `moved_ns`."""
        from_cdeg = None
        if self.on:
            if rules.takeover_cdeg_s and self.source != command.source and not self.eases:
                self.eases, self.said_ns = True, moved_ns or 0
        elif self.want is not None and self.starts:
            from_cdeg = self.want.from_cdeg
        else:
            from_cdeg = self.stands(now_ns, rules)
            if from_cdeg is None and rules.angles_first:
                from_cdeg = op.angle_cdeg
        kind = Op.START if self.starts else op.op
        self.want, self.bound_cdeg = Want(kind, op.angle_cdeg, command.number, from_cdeg), None
        self.source = command.source

    @property
    def on(self) -> bool:
        return self.written_cdeg is not None

    @property
    def starts(self) -> bool:
        return self.want is not None and self.want.op is Op.START

    def stop(self, by: str, instant_ns: int) -> None:
        """Record a Stop by this channel or cause, which ends its pending target."""
        self.want = self.bound_cdeg = self.edge_ns = None
        self.stopped_by = (self.stopped_by if self.stopped_ns == instant_ns else frozenset()) | {by}
        self.stopped_ns = instant_ns

    def owe(self, rules: Rules, now_ns: int) -> None:
        """Record a Stop that is to be repeated. A repeat that is owed already keeps its time."""
        self.owed_ns = self.owed_ns if self.owed else now_ns + rules.repeat_interval_ns
        self.owed = rules.repeats


@dataclass
class LegHistory:
    """One leg: when an accepted command last started or set a servo, when a frame moved it, what its bucket held."""

    commanded_ns: int | None = None
    moved_ns: int | None = None
    bucket_ns: int = 0
    """The bucket's content after that frame, in nanoseconds of rate slots."""
    source: str | None = None
    """The source of the command in force."""
    unfed_ns: int | None = None
    """Since when a start waits for its supply."""

    def key(self, now_ns: int, rules: Rules, *, armed: bool) -> tuple[object, ...]:
        """Return what still matters; see `RobotHistory.key`."""
        return (
            min(now_ns - self.commanded_ns, rules.timeout_ns) if self.commanded_ns is not None and armed else None,
            self.held_ns(now_ns, rules.period_ns),
            max(0, self.slot_ns(rules.period_ns) - now_ns),
            None if self.unfed_ns is None else min(now_ns - self.unfed_ns, rules.feed_ns),
        )

    # The rate is a token bucket: it fills by a rate slot in a period, up to three.

    def moved(self, now_ns: int, period_ns: int) -> None:
        """Record a frame that moves this leg now. Raise Violation if it may not."""
        held_ns = self.held_ns(now_ns, period_ns)
        demand(held_ns >= period_ns, "no frame without a rate slot")
        apart = self.moved_ns is None or 4 * (now_ns - self.moved_ns) >= period_ns
        demand(apart, "two frames of a leg are a quarter of its period apart: no burst")
        self.moved_ns, self.bucket_ns = now_ns, held_ns - period_ns

    def held_ns(self, now_ns: int, period_ns: int) -> int:
        """Return the bucket's content now."""
        full_ns = 3 * period_ns
        return full_ns if self.moved_ns is None else min(full_ns, self.bucket_ns + now_ns - self.moved_ns)

    def slot_ns(self, period_ns: int) -> int:
        """Return from when a frame for this leg need not wait any more."""
        if self.moved_ns is None:
            return 0
        quarter_ns = -(-period_ns // 4)
        return self.moved_ns + max(quarter_ns, period_ns - self.bucket_ns)


def change_hands(
    legs: Mapping[int, LegHistory],
    running: Iterable[int],
    command: events.Command,
    targets: events.Targets,
    effects: Iterable[events.Effect],
) -> None:
    """Give the legs that an accepted command names to its source. Demand an announcement for each that ran."""
    named = {servo_id // 10: legs[servo_id // 10] for servo_id, _ in targets}
    moved = {servo_id // 10 for servo_id, op in targets if op.op is not Op.STOP}
    changed = {number: leg for number, leg in named.items() if leg.source != command.source}
    changes = announced(effects, {Kind.SOURCE_CHANGED})
    expected = [
        events.Announce(
            Kind.SOURCE_CHANGED,
            f"leg {number} is commanded by {command.source or NOBODY}, and was by {leg.source or NOBODY}",
            command.source,
            legs=(number,),
            source_id=command.source_id,
        )
        for number, leg in changed.items()
        if number in running and (command.source is not None or number in moved)
    ]
    demand(changes == expected, f"changes of a leg's source are announced: {expected}, not {changes}")
    for leg in changed.values():
        leg.source = command.source


Gap = Callable[[int, int, int], tuple[int, int] | None]
"""`CalibrationHistory.gap`: takes a servo, and the angles from and to which it goes."""


def stepped(
    servo: ServoHistory, servo_id: int, angle_cdeg: int, target_cdeg: int, now_ns: int, rules: Rules, gap: Gap
) -> None:
    """Record a frame that takes a servo to an angle, towards its target. Raise Violation if it is too far or near."""
    stood_cdeg = servo.written_cdeg
    if servo.want is not None and not servo.on:
        stood_cdeg, servo.said_ns = servo.want.from_cdeg, now_ns
        servo.eases = rules.takeover_cdeg_s > 0 and stood_cdeg is not None
    speeds = [rules.max_speed_cdeg_s.get(servo_id), rules.takeover_cdeg_s if servo.eases else None]
    speed_cdeg_s = min((each for each in speeds if each is not None), default=None)
    if speed_cdeg_s is None or stood_cdeg is None:
        demand(angle_cdeg == target_cdeg, f"{servo_id}: the newest target is sent")
        return
    slot_cdeg = -(-speed_cdeg_s * rules.period_ns // NS_PER_S)
    most_cdeg = min(speed_cdeg_s * (now_ns - servo.said_ns) // NS_PER_S, slot_cdeg)
    gone_cdeg, way_cdeg = angle_cdeg - stood_cdeg, target_cdeg - stood_cdeg
    on_its_way = gone_cdeg * way_cdeg >= 0 and abs(gone_cdeg) <= abs(way_cdeg)
    demand(on_its_way, f"{servo_id} goes towards the newest target")
    edges = gap(servo_id, stood_cdeg, target_cdeg)
    if edges is None:
        servo.edge_ns = None
    elif angle_cdeg == edges[0]:  # it waits there until it would be beyond
        servo.edge_ns = servo.said_ns if servo.edge_ns is None else servo.edge_ns
    if edges is not None and gap(servo_id, angle_cdeg, target_cdeg) is None:
        since_ns = servo.said_ns if servo.edge_ns is None else servo.edge_ns
        beyond_cdeg, all_cdeg = abs(angle_cdeg - edges[1]), speed_cdeg_s * (now_ns - since_ns) // NS_PER_S
        demand(beyond_cdeg <= most_cdeg + 1, f"{servo_id} goes no faster than its speed behind the gap")
        demand(abs(gone_cdeg) <= all_cdeg + 1, f"{servo_id} goes across the gap no faster than its speed")
        servo.edge_ns = None
    else:
        what = f"{servo_id} goes no faster than its speed: {gone_cdeg}, not {most_cdeg}"
        demand(abs(gone_cdeg) <= most_cdeg + 1, what)
        waits = edges is not None and angle_cdeg == edges[0]
        enough = gone_cdeg == way_cdeg or waits or abs(gone_cdeg) >= most_cdeg
        demand(enough, f"{servo_id} goes as far as its speed allows")
    servo.bound_cdeg = None if gone_cdeg == way_cdeg else target_cdeg
    servo.eases = servo.eases and servo.bound_cdeg is not None


@dataclass
class LandingHistory:
    """A landing: when it began and must end, for each running servo where it was and where it goes, and which part of
    its way each has been commanded: a frame may add one rate slot's part at most."""

    began_ns: int
    ends_ns: int
    ways_cdeg: Mapping[int, tuple[int, int]]
    parts_ns: dict[int, int]

    def key(self, now_ns: int) -> tuple[object, ...]:
        """Return what still matters."""
        parts = tuple(sorted(self.parts_ns.items()))
        return now_ns - self.began_ns, self.ends_ns - now_ns, tuple(self.ways_cdeg.items()), parts

    def judge(
        self, transmit: Transmit, servos: Mapping[int, ServoHistory], now_ns: int, rules: Rules, gap: Gap
    ) -> None:
        """Judge a frame of a landing: running servos only, each on its line, or sent its present angle again."""
        length_ns = max(rules.period_ns, rules.landing_ns - 2 * rules.period_ns)
        rounded_cdeg = 1 + -(-length_ns // NS_PER_S)  # a speed is a whole number of hundredths of a degree a second
        for servo_id, op in transmit.frame.servos:
            servo = servos[servo_id]
            if op.op is Op.STOP:
                demand(not servo.on, f"{servo_id} is stopped by its landing before it ends")
                continue
            demand(servo.on and op.op is Op.SET, f"{servo_id} is started by a landing")
            first, last = self.ways_cdeg[servo_id]
            stood_cdeg = servo.written_cdeg or 0
            gone_ns = min(now_ns - self.began_ns, length_ns)
            self.parts_ns[servo_id] = part_ns = min(gone_ns, self.parts_ns.get(servo_id, 0) + rules.period_ns)
            # A frame's step is rounded up, so a late landing may be ahead of its slots' parts, and never of its time.
            lines_cdeg = []
            for line_ns in (part_ns, gone_ns):
                line_cdeg = first + (last - first) * line_ns // length_ns
                edges = gap(servo_id, stood_cdeg, last)
                waits = edges is not None and min(edges) < line_cdeg < max(edges)
                lines_cdeg.append(edges[0] if edges is not None and waits else line_cdeg)
            crosses = any(gap(servo_id, stood_cdeg, line_cdeg) is not None for line_cdeg in lines_cdeg)
            limited = servo_id in rules.max_speed_cdeg_s and (op.angle_cdeg != stood_cdeg or crosses)
            nearest, farthest = min(lines_cdeg) - rounded_cdeg, max(lines_cdeg) + rounded_cdeg
            if limited:
                nearest, farthest = min(nearest, stood_cdeg - rounded_cdeg), max(farthest, stood_cdeg + rounded_cdeg)
            on_line = nearest <= op.angle_cdeg <= farthest or op.angle_cdeg == stood_cdeg
            demand(on_line, f"{servo_id} leaves its straight line")
            most_cdeg = -(-abs(last - first) * rules.period_ns // length_ns)
            if limited:
                own_cdeg = rules.max_speed_cdeg_s[servo_id] * min(now_ns - servo.said_ns, rules.period_ns) // NS_PER_S
                most_cdeg = min(most_cdeg, own_cdeg)
            demand(crosses or abs(op.angle_cdeg - stood_cdeg) <= most_cdeg + 1, f"{servo_id} goes too fast")
            servo.written_cdeg, servo.said_ns, servo.bound_cdeg = op.angle_cdeg, now_ns, None
