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
    """How often legs at rest get a Stop while others run (Behaviour *Legs at rest*). No setting switches it off.

    Shorter than `RESYNC_NS` of the bus: with the preamble ahead of these Stops, the stream needs no other one.
    """
    rest_runs: int = 3
    """How many more runs of Stops follow the last Stop's repeats while nothing runs (Behaviour *Legs at rest*).

    One more follows these, with a frame for each servo: no bytes that are lost of it can start one.
    """
    rest_run_ns: int = 1_100 * NS_PER_MS
    """How far these runs are apart: the published firmware gives up a frame after 1000 ms, and then reads lengths."""
    period_ns: int = NS_PER_S // 50
    start_pause_ns: int = 0
    start_wait_ns: int = 0
    """How long a start without `sent_ms` waits for messages behind it; 0: bursts are not detected.

    Behaviour *Bursts without `sent_ms`*.
    """
    window_ns: int = 20 * NS_PER_MS
    """The time in which a burst is counted (`core/backlog.py`); neither this nor `start_wait_ns` is a setting."""
    unnumbered_reset_ns: int = 2 * NS_PER_S
    """How old the latest emergency stop must be for a reset without a number (Behaviour *Emergency stop*)."""
    joint_limits_cdeg: dict[int, tuple[int, int]] = field(default_factory=dict)
    avoid_cdeg: tuple[int, int] | None = None
    """Wire angles that are never sent: from the first up to, not including, the second."""
    max_speed_cdeg_s: dict[int, int] = field(default_factory=dict)
    """Servos that go no faster than this from one frame to the next (Behaviour *Speed*)."""
    takeover_cdeg_s: int = 0
    """The highest speed on the first way under another source, or behind a Stop; 0: off.

    Behaviour *Take-over and first frame*.
    """
    takeover_known_ns: int = 2 * NS_PER_S
    """How long after its Stop a servo counts as standing where it was; not a setting."""
    landing_ns: int = 0
    """How long a landing takes (Behaviour *Landing*); 0: a silent leg is stopped at once."""
    landing_cdeg: dict[int, int] = field(default_factory=dict)
    """The landing pose; a servo that is not named holds its angle."""
    lease_required: bool = False
    lease_ttl_ns: int = NS_PER_S
    buttons_required: int = 0
    """How many buttons must be alive for anything to move (Behaviour *Buttons*)."""
    buttons_timeout_ns: int = NS_PER_S
    """For how long a button is alive after a check-in."""
    starts_whole: bool = False
    """Whether the wire starts and stops all servos only (Behaviour *The whole robot*); `start_pause_ns` is then 0."""
    min_battery_mv: int = 0
    """Below it nothing is started (Behaviour *Measurements*); 0: no voltage is too low."""
    max_tilt_cdeg: int = 0
    """Beyond it for `tilt_ns`, the robot has fallen (Behaviour *Measurements*); 0: no tilt counts as a fall."""
    tilt_ns: int = 200 * NS_PER_MS
    """How long the tilt must last: longer than a stumble or a single bad value."""

    estop_kept: bool = False
    """Whether an earlier run may have left an emergency stop engaged; `EstopKept` follows (*Emergency stop*)."""
    power: bool = False
    """Whether a power board feeds the servos (Behaviour *Power*): a start then waits until its servo is fed."""
    angles_first: bool = False
    """Whether supply is what starts a servo: its angle is on the wire before it is fed."""
    feed_ns: int = 1800 * NS_PER_MS
    """How long a start waits for its supply. The board takes up to 1 s for 18 servos, and 0.4 s for the one that is
    judged first; a client waits 2 s for its answer."""

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
class Servo:
    """One servo as last written; `angle_cdeg` is None while it does not run, since its angle is then unknown."""

    servo_id: int
    leg: int
    angle_cdeg: int | None = None
    waiting: ServoOp | None = None
    """Its newest target, until that is sent."""
    waiting_for: Command = NO_COMMAND
    """Which command set it; NO_COMMAND: none, it is a step on the way to a target that a command was answered for."""
    announced_cdeg: int | None = None
    """Where supply starts servos: the angle on the wire before, which the servo takes once it is fed."""
    target_cdeg: int | None = None
    """Its target, while its speed is limited and it is not there yet."""
    target_for: Command = NO_COMMAND
    """Which command set that target."""
    since_ns: int = 0
    """From when the time for its next step counts."""
    source: str | None = None
    """Who started or set it last."""
    eases: bool = False
    """Whether it goes to its target no faster than `Rules.takeover_cdeg_s`, until it is there."""
    stopped: tuple[int, int, RobotCalibration] | None = None
    """Its angle when it was stopped, when that was, and by which calibration the angle counts; None: it never ran."""
    passing_cdeg: int | None = None
    """Where it would be on its way through angles that are not sent, and at whose near end it waits."""
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
        """Whether a `set` has something to set: the servo runs, or waits to be started."""
        return self.angle_cdeg is not None or (self.waiting is not None and self.waiting.op is OP_START)

    def note_stop(self, by: str, instant_ns: int) -> None:
        """Record that channel or cause `by` stopped the servo in this instant."""
        earlier = self.stopped_by if self.stopped_ns == instant_ns else frozenset[str]()
        self.stopped_by = earlier | {by}
        self.stopped_ns = instant_ns


@dataclass(slots=True)
class Leg:
    """One leg: its servos, its rate slots, and when an accepted command last started or set one of its servos."""

    number: int
    servos: tuple[Servo, Servo, Servo]
    slots: RateSlots
    commanded_ns: int | None = None
    expired: bool = False
    source: str | None = None
    """Whose command is in force: the latest accepted one's; None once the gateway has stopped the leg itself."""
    eases: bool = False
    """Whether a servo of it may ease (`Servo.eases`), or is to be started."""
    landed_ns: int = 0
    """How far along the landing its frames are, in ns of the landing's time."""
    unfed_ns: int | None = None
    """Since when a start of it waits for supply, as of the last `Legs.plan`; None: none does."""
    due_ns: int = NEVER
    """When its deadline, its rate slot or a repeated Stop comes; like the next three as of the last `Legs.plan`."""
    repeat_ns: int = NEVER
    """When its next repeated Stop comes."""
    runs: bool = False
    """Whether one of its servos runs."""
    rests: bool = True
    """Whether none runs, and none waits to be started."""

    @property
    def waits_to_start(self) -> bool:
        """Whether its next frame would energise a servo."""
        return any(servo.will_run and not servo.running for servo in self.servos)

    @property
    def is_bound(self) -> bool:
        """Whether a servo of it is on its way to a target."""
        first, second, third = self.servos
        return not (first.target_cdeg is second.target_cdeg is third.target_cdeg is None)

    @property
    def armed(self) -> bool:
        """Whether one of its servos runs, or waits to be started."""
        first, second, third = self.servos
        return first.will_run or second.will_run or third.will_run

    def deadline_ns(self, timeout_ns: int) -> int | None:
        """Return when the watchdog stops this leg, or None if nothing is to stop or the leg only waits for supply."""
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
