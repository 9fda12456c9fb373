"""The supervisor's settings, and its state of each leg and servo. Pure."""

from dataclasses import dataclass, field
from typing import Final

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.model.calibration import RobotCalibration
from gateway.model.frames import OP_START, STOP_REPEAT_MS, STOP_REPEATS, ServoOp, servo_ids_of
from gateway.robot.core.events import Command
from gateway.robot.core.pacing import NEVER, RateSlots
from schemas.telemetry import WatchdogState

NO_COMMAND: Final = Command(())


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
    """Whether the wire only starts and stops all servos (Behaviour *The whole robot*); then `start_pause_ns` is 0."""
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

    def __post_init__(self) -> None:
        if self.starts_whole and self.start_pause_ns:
            raise ValueError("a robot that starts as a whole cannot start leg by leg")
        if self.starts_whole and self.power:
            raise ValueError("a power board starts servos one by one")

    @property
    def stops_whole(self) -> bool:
        """Whether the silence of one leg stops all six."""
        return self.whole_robot or self.starts_whole


@dataclass(slots=True)
class Servo:  # mutants accepted (Step): set before it is read
    """One servo as last written; `angle_cdeg` is None while it does not run, since its angle is then unknown."""

    servo_id: int
    leg: int
    angle_cdeg: int | None = None
    waiting: ServoOp | None = None
    """Its newest target, until that is sent."""
    waiting_for: Command = NO_COMMAND
    """The command that set `waiting`; NO_COMMAND: a step towards the target of an already answered command."""
    announced_cdeg: int | None = None
    """If supply starts servos: the angle on the wire before, which the servo takes once it is powered."""
    target_cdeg: int | None = None
    """Its target, while its speed is limited and it has not arrived."""
    target_for: Command = NO_COMMAND
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
    def will_run(self) -> bool:
        """Whether the servo runs or waits to be started, so that a `set` applies to it."""
        return self.angle_cdeg is not None or (self.waiting is not None and self.waiting.op is OP_START)

    def note_stop(self, by: str, instant_ns: int) -> None:
        """Record that channel or cause `by` stopped the servo in this instant."""
        earlier = self.stopped_by if self.stopped_ns == instant_ns else frozenset[str]()
        self.stopped_by = earlier | {by}
        self.stopped_ns = instant_ns


@dataclass(slots=True)
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
    """When one of its starts began to wait for power, or None; as of the last `Legs.plan`, like the following."""
    due_ns: int = NEVER
    """When its next deadline, rate slot or repeated Stop is due."""
    repeat_ns: int = NEVER
    runs: bool = False
    rests: bool = True
    """Whether no servo runs or waits to be started."""

    @property
    def waits_to_start(self) -> bool:
        """Whether its next frame would energise a servo."""
        return any(servo.will_run and not servo.running for servo in self.servos)

    @property
    def is_bound(self) -> bool:
        """Whether one of its servos is on its way to a target."""
        first, second, third = self.servos
        return not (first.target_cdeg is second.target_cdeg is third.target_cdeg is None)

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
    return Servo(first, leg), Servo(second, leg), Servo(third, leg)
