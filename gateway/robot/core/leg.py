"""The supervisor's settings; a leg's rate slots, its servos, and its frames' effects. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import (
    OP_START,
    SETS,
    STOP,
    STOP_REPEAT_MS,
    STOP_REPEATS,
    Frame,
    OneLeg,
    OneServo,
    ServoOp,
    servo_ids_of,
    stop_leg,
)
from gateway.robot.core.events import Announce, Command, Effect, Rejected, Transmit
from schemas.telemetry import Cause, Kind, Reason, WatchdogState

_NO_COMMAND: Final = Command(())


@dataclass(frozen=True, slots=True)
class Rules:
    """The settings that the supervisor needs, in nanoseconds and hundredths of a degree."""

    timeout_ns: int = 250 * NS_PER_MS
    whole_robot: bool = False
    repeats: int = STOP_REPEATS
    repeat_interval_ns: int = round(STOP_REPEAT_MS * NS_PER_MS)
    rest_ns: int = 800 * NS_PER_MS
    """Period of Stops for legs at rest while others run (Behaviour *Legs at rest*). No setting switches them off.

    It is shorter than `RESYNC_NS` of the bus: the preamble of these Stops serves the stream, too.
    """
    rest_runs: int = 3
    """Further runs of Stops after the last Stop's repeats while nothing runs (Behaviour *Legs at rest*).

    After these, one run has a frame for each servo: with lost bytes it cannot start a servo.
    """
    rest_run_ns: int = 1_100 * NS_PER_MS
    """Time between these runs: the published firmware gives up a frame after 1000 ms, and then reads lengths."""
    period_ns: int = NS_PER_S // 50
    start_pause_ns: int = 0
    start_wait_ns: int = 0
    """How long a start without `sent_ms` waits for later messages (*Bursts without `sent_ms`*); 0: no detection."""
    window_ns: int = 20 * NS_PER_MS
    """The time in which a burst is counted (`core/backlog.py`)."""
    unnumbered_reset_ns: int = 2 * NS_PER_S
    """The least age of an emergency stop for a reset without a number (Behaviour *Emergency stop*)."""
    joint_limits_cdeg: dict[int, tuple[int, int]] = field(default_factory=dict)
    avoid_cdeg: tuple[int, int] | None = None
    """Wire angles that are never sent: from the first up to, not including, the second."""
    max_speed_cdeg_s: dict[int, int] = field(default_factory=dict)
    """The highest speed of servos with a limit, from frame to frame (Behaviour *Speed*)."""
    takeover_cdeg_s: int = 0
    """The highest speed to the first target of another source or after a Stop (*Take-over and first frame*); 0: off."""
    takeover_known_ns: int = 2 * NS_PER_S
    """How long after its Stop a servo's angle counts as known."""
    landing_ns: int = 0
    """How long a landing takes (Behaviour *Landing*); 0: a silent leg is stopped at once."""
    landing_cdeg: dict[int, int] = field(default_factory=dict)
    """The landing pose; servos without an angle here hold theirs."""
    lease_required: bool = False
    lease_ttl_ns: int = NS_PER_S
    buttons_required: int = 0
    """How many buttons must be alive for anything to move (Behaviour *Buttons*)."""
    buttons_timeout_ns: int = NS_PER_S
    """How long a button is alive after a check-in."""
    starts_whole: bool = False
    """Whether the wire only starts and stops all servos (*The whole robot*): without `start_pause_ns` and `power`."""
    min_battery_mv: int = 0
    """The lowest voltage for starts (Behaviour *Measurements*); 0: no limit."""
    max_tilt_cdeg: int = 0
    """Tilted further for `tilt_ns`, the robot has fallen (Behaviour *Measurements*); 0: no tilt counts as a fall."""
    tilt_ns: int = 200 * NS_PER_MS
    """How long the tilt must last: longer than a stumble or a single bad value."""

    estop_kept: bool = False
    """Whether an earlier run may have left an emergency stop engaged; `EstopKept` follows (*Emergency stop*)."""
    power: bool = False
    """Whether a power board powers the servos (Behaviour *Power*): then a start waits for its servo's power."""
    angles_first: bool = False
    """Whether supply starts a servo: then its angle is on the wire before its power."""
    feed_ns: int = 1800 * NS_PER_MS
    """How long a start waits for power. The board takes up to 1 s for 18 servos, and 0.4 s for the first one, which is
    powered alone. A client waits 2 s for its answer."""

    @property
    def stops_whole(self) -> bool:
        """Whether the silence of one leg stops all six."""
        return self.whole_robot or self.starts_whole


# ---- when a leg's next frame may leave

NEVER: Final = 2**63  # mutants accepted (Step): later than any time
"""Later than any time."""

BUCKET: Final = 3
"""At 50 Hz, Wi-Fi delivers a setpoint up to 15 ms early or late: up to 30 ms between two, which is one and a half
periods. Three slots cover two periods, since the frame itself uses one."""
SPACING_SHARE: Final = 4
"""The least time between two frames of a leg is its period divided by this."""


@dataclass(slots=True)
class RateSlots:  # mutants accepted (Gt_GtE, Step): equal times; a clock begins at 0
    """When a leg's next frame may leave, in integer ns of the monotonic clock. Before the first, the bucket is full.

    A leg gets one rate slot in each period. A command with a free slot leaves at once and uses it up. A command without
    waits, and only the newest target of each servo is kept. Up to `BUCKET` unused slots are kept (a token bucket), so
    that a stream at the limit's rate passes unchanged although its messages arrive early and late. Older slots are
    dropped.

    Kept slots make no burst: two frames of a leg are at least a quarter of its period apart. So at most rate + 3 frames
    leave in any second, and exactly the rate in the long run. Stop frames need no slot.
    """

    period_ns: int
    oldest_ns: int = -BUCKET * NS_PER_S  # the longest period is 1 s, and the clock begins at 0
    """When the oldest kept slot began, or the next one begins."""
    next_ns: int = 0
    """When the next frame may leave."""
    taken_ns: int = 0
    """When the latest frame left."""

    def wait_until(self, until_ns: int) -> None:
        """Let no frame leave before this time."""
        self.next_ns = until_ns if until_ns > self.next_ns else self.next_ns

    def take(self, now_ns: int) -> None:
        """Use up the oldest slot that the bucket holds, for a frame that leaves now."""
        kept_ns = now_ns - (BUCKET - 1) * self.period_ns
        self.oldest_ns = (self.oldest_ns if self.oldest_ns > kept_ns else kept_ns) + self.period_ns
        self.taken_ns = now_ns
        soonest_ns = now_ns - (-self.period_ns // SPACING_SHARE)  # rounded up: never closer
        self.next_ns = self.oldest_ns if self.oldest_ns > soonest_ns else soonest_ns


@dataclass(slots=True)
class StartQueue:  # mutants accepted (Step): a clock begins at 0
    """Legs that wait to be energised, in order, at least `pause_ns` apart (0: all at once).

    The starting current of eighteen servos at once can overload the supply.
    """

    pause_ns: int
    next_ns: int = 0
    legs: list[int] = field(default_factory=list)

    def passes(self, leg: int, slots: RateSlots, now_ns: int, starts: bool) -> bool:
        """Return whether a frame of `leg` may leave now. A start waits in the queue, and for its rate slot."""
        if not starts:
            self.leave(leg)
            return True
        if leg not in self.legs:  # a waiting leg keeps its place
            self.legs.append(leg)
        if self.legs[0] != leg or now_ns < self.next_ns or now_ns < slots.next_ns:
            return False
        self.leave(leg)
        self.next_ns = now_ns + self.pause_ns
        return True

    def leave(self, leg: int) -> None:
        """Remove `leg` from the queue, if it waits."""
        if leg in self.legs:
            self.legs.remove(leg)

    def due_ns(self, leg: int, slot_ns: int) -> int | None:
        """Return when a leg with its slot at `slot_ns` may send, or None if another leg precedes it."""
        if leg not in self.legs:
            return slot_ns
        return max(slot_ns, self.next_ns) if self.legs[0] == leg else None


# ---- its state


@dataclass(slots=True, eq=False)
class Servo:  # mutants accepted (Step): set before it is read
    """One servo as last written; `angle_cdeg` is None while it does not run, since its angle is then unknown."""

    servo_id: int
    angle_cdeg: int | None = None
    waiting: ServoOp | None = None
    """Its newest target, until a frame has it."""
    waiting_for: Command = _NO_COMMAND
    """The command that set `waiting`."""
    begun: bool = False
    """Whether a frame has made a step towards `waiting`, since the servo's speed is limited. Its command is done."""
    from_cdeg: int | None = None
    """The angle at which its waiting start begins: where it stood, if known, or if supply starts servos, the first
    target. None: at the newest target."""
    since_ns: int = 0
    """When the time for its next step begins."""
    source: str | None = None
    """The source that started or set it last."""
    eases: bool = False
    """Whether `Rules.takeover_cdeg_s` limits its speed until it arrives."""
    stopped: tuple[int, int, RobotCalibration] | None = None
    """Its angle at its latest Stop, the Stop's time (ns), and the angle's calibration; None: it never ran."""
    passing_cdeg: int | None = None
    """Its computed angle within a range that is never sent, at whose near end it waits."""
    repeats_left: int = 0
    repeat_ns: int = 0
    stopped_ns: int | None = None
    stopped_by: frozenset[str] = frozenset()
    """The channels of the commands, or the gateway's own causes, that stopped it at `stopped_ns`."""

    @property
    def running(self) -> bool:
        return self.angle_cdeg is not None

    @property
    def pending(self) -> bool:
        """Whether no frame has carried out its newest command yet."""
        return self.waiting is not None and not self.begun

    @property
    def starts(self) -> bool:
        """Whether a start of this servo waits."""
        return self.angle_cdeg is None and self.waiting is not None and self.waiting.op is OP_START

    @property
    def will_run(self) -> bool:
        """Whether the servo runs or waits to be started, so that a `set` applies to it."""
        return self.angle_cdeg is not None or (self.waiting is not None and self.waiting.op is OP_START)

    def note_stop(self, by: str, instant_ns: int) -> None:
        """Record that channel or cause `by` stopped the servo in this instant."""
        earlier = self.stopped_by if self.stopped_ns == instant_ns else frozenset[str]()
        self.stopped_by = earlier | {by}
        self.stopped_ns = instant_ns


@dataclass(slots=True, eq=False)
class Leg:  # mutants accepted (FalseWithTrue, Step, TrueWithFalse): set before it is read
    """One leg: its servos, its rate slots, and when an accepted command last started or set one of its servos."""

    number: int
    servos: tuple[Servo, Servo, Servo]
    slots: RateSlots
    commanded_ns: int | None = None
    expired: bool = False
    source: str | None = None
    """The source of the latest accepted command; None once the gateway itself has stopped the leg."""
    eases: bool = False
    """Whether one of its servos may ease (`Servo.eases`) or waits to be started."""
    landed_ns: int = 0
    """The progress of its frames in the landing, in ns of the landing's time."""
    unfed_ns: int | None = None
    """When one of its starts began to wait for power, or None; as of the last `Legs.plan`."""

    @property
    def runs(self) -> bool:
        """Whether one of its servos runs."""
        first, second, third = self.servos
        return first.running or second.running or third.running

    @property
    def waits_to_start(self) -> bool:
        """Whether its next frame would energise a servo."""
        return any(servo.starts for servo in self.servos)

    @property
    def armed(self) -> bool:
        """Whether one of its servos runs, or waits to be started."""
        first, second, third = self.servos
        return first.will_run or second.will_run or third.will_run

    def deadline_ns(self, timeout_ns: int) -> int | None:
        """Return when the watchdog stops this leg, or None if the leg rests or only waits for power."""
        waits = self.unfed_ns is not None and not self.runs
        return self.commanded_ns + timeout_ns if self.commanded_ns is not None and self.armed and not waits else None

    @property
    def watchdog(self) -> WatchdogState:
        if self.expired:
            return WatchdogState.EXPIRED
        return WatchdogState.ARMED if self.armed else WatchdogState.IDLE


def servos_of(leg: int) -> tuple[Servo, Servo, Servo]:
    """Return a leg's three servos, at rest."""
    first, second, third = servo_ids_of(leg)
    return Servo(first), Servo(second), Servo(third)


# ---- its effects


# mutants accepted (Step): the longer way leads to the same frame
def frame_of(leg: Leg, named: Sequence[tuple[Servo, ServoOp]]) -> Frame:
    """Return the frame with these operations. If it names two servos, the third repeats its current state."""
    if named[2:]:
        (_, one), (_, two), (_, three) = named
        return OneLeg(leg.number, (one, two, three))
    (servo, op), *more = named
    if not more:
        return OneServo(servo.servo_id, op)
    ops = dict(named)
    one, two, three = (ops.get(each, STOP if each.angle_cdeg is None else SETS[each.angle_cdeg]) for each in leg.servos)
    return OneLeg(leg.number, (one, two, three))


def stops(
    leg: Leg,
    servos: Sequence[Servo],
    cause: Cause,
    commands: tuple[Command, ...] = (),
    *,
    joins: bool = False,
    singly: bool = False,
) -> list[Effect]:
    """Return Stops for these servos of a leg: one frame for all three, else, or `singly`, one for each."""
    if len(servos) == len(leg.servos) and not singly:
        return [Transmit(stop_leg(leg.number), cause, None, commands, joins=joins)]
    return [Transmit(OneServo(servo.servo_id, STOP), cause, None, commands) for servo in servos]


def taken_over(leg: Leg, source: str | None, moves: bool) -> list[Effect]:
    """Set the leg's source, and return the event if the leg had another. A stopped leg has no previous source.

    A Stop without a name (a delete has none) may be from the leg's previous source.
    """
    before, leg.source = leg.source, source
    if not leg.armed or (source is None and not moves):
        return []
    new, old = ("somebody without a name" if name is None else name for name in (source, before))
    detail = f"leg {leg.number} is commanded by {new}, and was by {old}"
    return [Announce(Kind.SOURCE_CHANGED, detail, source, legs=(leg.number,))]


def withdrawn(command: Command, reason: Reason, detail: str) -> Rejected:
    """Return the rejection of a command that is dropped. Its Stops were written, unless the bus failed."""
    if reason is not Reason.BUS_FAULT:
        command.stopped = tuple(servo_id for servo_id, _ in command.stops)
    return Rejected(command, reason, detail)
