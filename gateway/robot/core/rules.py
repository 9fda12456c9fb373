"""The settings that the supervisor needs. Pure."""

from dataclasses import dataclass, field

from gateway.model.frames import STOP_REPEAT_MS, STOP_REPEATS
from gateway.rate_limit import NS_PER_MS, NS_PER_S


@dataclass(frozen=True, slots=True)
class Rules:
    """All times are in nanoseconds, all angles in hundredths of a degree."""

    wire: str = "the SPI bus"
    """The wire's name in sentences."""
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
    """How long a start without `sent_ms` waits for later messages (*Bursts without `sent_ms`*); 0: no detection.

    `core/backlog.py` uses this and the next five.
    """
    apart_ns: int = 400_000
    """Two messages of a key that are this far apart do not arrive in a clump: at 1000 Hz they are 1 ms apart."""
    silence_ns: int = 40 * NS_PER_MS
    """A key without a message for this long is silent: at 1 Mbit/s, a backlog's segments are 11.6 ms apart."""
    proof_ns: int = 400 * NS_PER_MS
    """How long a start waits for evenly arriving messages at most."""
    quiet_ns: int = 250 * NS_PER_MS
    """After a silence of this length, a key begins anew: TCP repeats a lost segment after 200 ms."""
    most_clumped: int = 12
    """The highest score. A stream loses it in 12 messages: 240 ms at 50 Hz."""
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
    def wire_fault(self) -> str:
        """Why commands are rejected while the wire is at fault."""
        return f"{self.wire} is at fault; the gateway is trying to open it again"

    @property
    def stops_whole(self) -> bool:
        """Whether the silence of one leg stops all six."""
        return self.whole_robot or self.starts_whole
