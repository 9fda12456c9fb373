"""Payloads that go out: acknowledgements, state, events and frame records."""

import math
from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

Count = Annotated[int, Field(ge=0)]
CUT = "…"
"""Ends a text that was cut."""


class Report(BaseModel):
    """Frozen and open: fields are only ever added, and readers ignore unknown ones.

    An older reader that rejected them would show NOT STOPPED after a successful stop.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")


class Reason(StrEnum):
    """Why a command was rejected."""

    TOO_LARGE = "too_large"
    BAD_ENCODING = "bad_encoding"
    MALFORMED = "malformed"
    INVALID = "invalid"
    SERVO_STOPPED = "servo_stopped"
    JOINT_LIMIT = "joint_limit"
    STALE = "stale"
    ESTOPPED = "estopped"
    BUS_FAULT = "bus_fault"
    STOPPING = "stopping"
    NOT_HOLDER = "not_holder"
    NO_LEASE = "no_lease"
    LEASE_HELD = "lease_held"
    LEASE_DENIED = "lease_denied"
    LANDING = "landing"
    OVERFLOW = "overflow"
    REVOCATION_DENIED = "revocation_denied"
    NO_BUTTON = "no_button"
    UNKNOWN_BUTTON = "unknown_button"
    BUTTON_DENIED = "button_denied"
    BATTERY_LOW = "battery_low"
    WHOLE_ROBOT = "whole_robot"
    FALLEN = "fallen"
    NO_POWER = "no_power"


class Mode(StrEnum):
    """What the gateway as a whole is doing."""

    STARTING = "starting"
    IDLE = "idle"
    ACTIVE = "active"
    ESTOPPED = "estopped"
    BUS_FAULT = "bus_fault"
    STOPPING = "stopping"


class Kind(StrEnum):
    """What an event reports."""

    STARTED = "started"
    COMMAND_REJECTED = "command_rejected"
    WATCHDOG_EXPIRED = "watchdog_expired"
    ESTOP_ENGAGED = "estop_engaged"
    ESTOP_RESET = "estop_reset"
    ESTOP_KEPT = "estop_kept"
    ESTOP_NOT_KEPT = "estop_not_kept"
    BUS_FAULT = "bus_fault"
    BUS_RECOVERED = "bus_recovered"
    STOPPING = "stopping"
    STOPPED_OUTSIDE = "stopped_outside"
    SOURCE_CHANGED = "source_changed"
    LEASE_ACQUIRED = "lease_acquired"
    LEASE_RELEASED = "lease_released"
    LEASE_EXPIRED = "lease_expired"
    LEASE_TAKEN = "lease_taken"
    LEASE_ASKED = "lease_asked"
    LANDING = "landing"
    CALIBRATED = "calibrated"
    OVERFLOW = "overflow"
    BUS_MEDDLED = "bus_meddled"
    REVOKED = "revoked"
    BUTTON_REGISTERED = "button_registered"
    BUTTON_SILENT = "button_silent"
    BUTTON_LEFT = "button_left"
    BUTTON_RETURNED = "button_returned"
    CONTROLLER_SILENT = "controller_silent"
    CONTROLLER_RESTARTED = "controller_restarted"
    CONTROLLER_RETURNED = "controller_returned"
    BATTERY_LOW = "battery_low"
    FALLEN = "fallen"
    POWER_CUT = "power_cut"
    POWER_RESTORED = "power_restored"
    POWER_UNCONFIRMED = "power_unconfirmed"
    POWER_FAULT = "power_fault"
    SERVO_DRAWS = "servo_draws"
    SERVO_SILENT = "servo_silent"
    OFF_BUTTON = "off_button"


class Cause(StrEnum):
    """Why a frame was written."""

    COMMAND = "command"
    WATCHDOG = "watchdog"
    ESTOP = "estop"
    STARTUP = "startup"
    SHUTDOWN = "shutdown"
    REPEAT = "repeat"


class WatchdogState(StrEnum):
    """State of a leg's watchdog: no servo runs, it is armed, or it has stopped the leg."""

    IDLE = "idle"
    ARMED = "armed"
    EXPIRED = "expired"


OrText = Field(union_mode="left_to_right")
"""For values that later versions may extend: an unknown one is read as text."""
AnyReason = Annotated[Reason | str, OrText]
AnyMode = Annotated[Mode | str, OrText]
AnyKind = Annotated[Kind | str, OrText]
AnyCause = Annotated[Cause | str, OrText]
AnyWatchdogState = Annotated[WatchdogState | str, OrText]


class Sparse(Report):
    """One whose null fields are left out of its JSON and its repr."""

    @model_serializer(mode="wrap")
    def _without_nulls(self, handler: SerializerFunctionWrapHandler) -> dict[str, object]:
        return {name: value for name, value in handler(self).items() if value is not None}

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        return ((name, value) for name, value in super().__repr_args__() if value is not None)


class Answer(Sparse):
    """What every reply to a request says."""

    accepted: bool
    reason: AnyReason | None = None
    detail: str | None = None

    def or_raise(self) -> Self:
        """Return itself. Raises gateway.errors.RejectedError with the gateway's reason if the command was rejected."""
        if not self.accepted:
            from gateway.errors import RejectedError  # noqa: PLC0415  # schemas alone need no gateway

            raise RejectedError(str(self.reason or ""), self.detail or "no reason was given")
        return self


class Ack(Answer):
    """The reply to an acknowledged command; null fields are left out of the JSON."""

    coalesced: Literal[True] | None = None
    written: list[int] | None = None
    stopped: Annotated[
        Literal[True] | None, Field(description="with accepted false: what it may stop is stopped all the same")
    ] = None
    stop_frames: Count | None = None
    estop: Count | None = None
    latency_us: Annotated[float, Field(ge=0)] | None = None
    confirmed: Annotated[
        bool | None, Field(description="whether the power board has confirmed the supply off; null: there is no board")
    ] = None
    confirmed_ms: Annotated[float | None, Field(ge=0, description="how long after the command that was")] = None

    def __bool__(self) -> bool:
        """Whether the command was accepted."""
        return self.accepted


class ServoReport(Report):
    """One servo as last commanded; nothing comes back from the controller."""

    id: int
    running: bool
    angle_deg: float | None
    target_deg: Annotated[
        float | None, Field(description="where it is commanded to go, if it runs or waits to be started")
    ] = None


class LegReport(Report):
    """One leg; `age_ms`: since an accepted command started or set one of its servos, null before the first.

    `source`: of the command in force; null if it has none, and once the gateway itself has stopped the leg.
    """

    leg: int
    watchdog: AnyWatchdogState
    age_ms: float | None
    servos: tuple[ServoReport, ServoReport, ServoReport]
    source: str | None = None

    def is_of(self, source: str) -> bool:
        """Whether `source`'s command is in force; a long name may be cut, and then ends with `CUT`."""
        shown = self.source or ""
        begin = shown.removesuffix(CUT)
        return shown == source or (begin not in ("", shown) and source.startswith(begin))

    @property
    def running(self) -> bool:
        """Whether one of its servos runs."""
        return any(servo.running for servo in self.servos)

    @property
    def angles_deg(self) -> tuple[float | None, ...]:
        """The commanded angles of joints 1, 2, 3; None for a servo that is stopped."""
        return tuple(servo.angle_deg for servo in self.servos)

    def __repr__(self) -> str:
        doing = ("runs" if self.running else "is off", "" if self.source is None else f" by {self.source!r}")
        return f"<leg {self.leg} {''.join(doing)}, {self.angles_deg}>"

    __str__ = __repr__


class CommandCounts(Report):
    """Commands since the start; a coalesced one was accepted, then replaced by a newer one before it was written."""

    accepted: Count
    rejected: Count
    coalesced: Count
    overflows: Annotated[Count, Field(description="times that messages of one key were lost before they were read")] = 0
    lost: Annotated[Count, Field(description="messages that were lost in these, at least")] = 0


class SpiConfig(Report):
    """The SPI device."""

    device: str
    framing: str


class SpiCounts(Report):
    """Frames and faults since the start."""

    frames: Count
    errors: Count


class SpiReport(SpiCounts, SpiConfig):
    """The SPI device, its frames and faults since the start."""


class StopLatency(Report):
    """Microseconds from a watchdog's deadline to its Stop written; null before the first."""

    p50: float | None
    p99: float | None
    max: float | None


class LoopLag(Report):
    """Lateness of the gateway's timers in microseconds, since the start; percentiles are upper ends of buckets."""

    p50: float | None = None
    p99: float | None = None
    max: float | None = None


class WatchdogConfig(Report):
    """The watchdog's settings."""

    timeout_ms: float
    landing_ms: float = 0.0


class WatchdogCounts(Report):
    """The watchdog's counters."""

    expirations: Count
    stop_latency_us: StopLatency


class WatchdogReport(WatchdogCounts, WatchdogConfig):
    """The watchdog's settings and counters."""

    @property
    def stops_after_ms(self) -> float:
        """Longest time from a leg's last command to its Stop."""
        return self.timeout_ms + self.landing_ms


class LeaseReport(Report):
    """The lease. While it is handed over, `holder` is who may acquire it, and `held_s` is null."""

    holder: str | None = None
    verified: bool = False
    held_s: float | None = None
    expires_in_ms: float | None = None
    asked_by: str | None = None


class ButtonsConfig(Report):
    """How many stop buttons must be alive."""

    required: Count = 0


class ButtonsAlive(Report):
    """The stop buttons that are alive."""

    alive: Annotated[Count, Field(description="certificates; names where nothing is proved")] = 0
    names: Annotated[tuple[str, ...], Field(description="of all that are alive")] = ()


class ButtonsReport(ButtonsAlive, ButtonsConfig):
    """Stop buttons; nothing moves while fewer are alive than required."""


class CalibrationReport(Report):
    """The calibration in force, without its numbers; those are on `hexapod/calibration`."""

    revision: Count = 0
    fault: Annotated[
        str | None, Field(description="why the kept calibration cannot be used; nothing can be started then")
    ] = None
    kept: Annotated[
        bool, Field(description="whether it is there after the next boot; false: not, as far as the gateway can tell")
    ] = False


class TelemetryReport(Report):
    """What the gateway publishes besides the state."""

    frames: Annotated[
        bool | None, Field(description="whether `hexapod/frame` is published; null: an older gateway does not say")
    ] = None


class CertificateReport(Report):
    """The first of the gateway's certificates to expire."""

    file: str
    expires: AwareDatetime


class RevocationsReport(Report):
    """The list of revoked certificates in force."""

    number: Annotated[int, Field(description="grows with each list that `certs revoke` signs")]
    date: Annotated[AwareDatetime, Field(description="when it was signed")]


class ServoLimitsReport(Report):
    """The settings' limits of one servo, in degrees as in commands; a speed of 0 is unlimited."""

    min_deg: float = 0.0
    max_deg: float = 180.0
    max_speed_deg_s: float = 0.0


class Battery(Report):
    """The robot's battery; percent as the robot says it."""

    voltage_v: float
    percent: float


class Imu(Report):
    """The body's inertial sensor: how it stands, turns and is accelerated, in its own frame."""

    orientation_wxyz: tuple[float, float, float, float]
    angular_velocity_rad_s: tuple[float, float, float]
    linear_acceleration_m_s2: tuple[float, float, float]


class ServoTelemetry(Sparse):
    """What a power board measures of one servo."""

    supplied: bool
    current_a: float | None = None


class Supply(Report):
    """What feeds the servos."""

    voltage_v: float
    current_a: float


class Telemetry(Sparse):
    """The payload of `hexapod/telemetry`: what the robot measures; what it does not measure is left out."""

    time: AwareDatetime
    age_ms: Annotated[float, Field(ge=0, description="of the oldest of these values")]
    temperature_c: float | None = None
    battery: Battery | None = None
    imu: Imu | None = None
    tilt_deg: Annotated[float | None, Field(description="between the body's up and the world's, 0 to 180")] = None
    feet: Annotated[
        tuple[float, float, float, float, float, float] | None,
        Field(description="forces of legs 1 to 6, in the robot's own unit"),
    ] = None
    servos: Annotated[dict[str, ServoTelemetry] | None, Field(description="by servo id")] = None
    supply: Supply | None = None
    converters_v: tuple[float, ...] | None = None
    board_temperatures_c: tuple[float, ...] | None = None


class WireReport(Report):
    """The wire to the controller, and what depends on it."""

    name: str = ""
    whole_robot: Annotated[bool, Field(description="only all servos together can be started and stopped")] = False
    measures: Annotated[bool, Field(description="telemetry comes back")] = False
    acknowledges: Annotated[
        bool, Field(description="a frame counts as written only once the controller has confirmed it")
    ] = False
    supply_starts: Annotated[bool, Field(description="with a power board, supply is what starts a servo")] = False


class ControllerReport(Report):
    """The controller. One that sends nothing may be dead or alive: null."""

    alive: Annotated[bool | None, Field(description="false: its heartbeats or its answers are missing")] = None
    age_ms: Annotated[float | None, Field(description="since its last well-formed answer")] = None


class PowerReport(Report):
    """The board that feeds the servos, where the settings name one."""

    interface: str
    alive: Annotated[bool, Field(description="whether it answers")]
    supplied: Annotated[tuple[int, ...], Field(description="servos that it fed when it last said so, ascending")] = ()
    confirmed: Annotated[bool, Field(description="whether it has said that all is off which is to be off")] = False
    age_ms: Annotated[float | None, Field(description="since it last answered; null: it never has")] = None


class LimitsReport(Report):
    """The settings' limits of legs and servos. The calibration's limits are on `hexapod/calibration`."""

    leg_rate_hz: float = 50.0
    max_age_ms: Annotated[float, Field(description="0: any age; an older gateway does not say")] = 500.0
    servos: Annotated[dict[str, ServoLimitsReport], Field(description="of all eighteen")] = {}


class ConfigReport(Report):
    """The payload of `hexapod/config`: what seldom changes."""

    config: Annotated[str, Field(description="of these values; another state of them has another")] = ""
    version: str
    protocol: str
    simulated: bool
    spi: SpiConfig
    watchdog: WatchdogConfig
    buttons: Annotated[ButtonsConfig, Field(description="an older gateway has none")] = ButtonsConfig()
    calibration: Annotated[CalibrationReport, Field(description="an older gateway has none")] = CalibrationReport()
    telemetry: Annotated[TelemetryReport, Field(description="an older gateway does not say")] = TelemetryReport()
    certificate: Annotated[
        CertificateReport | None, Field(description="the first to expire; null: none are in use, or an older gateway")
    ] = None
    missing_endpoints: Annotated[
        tuple[str, ...],
        Field(description="those that the gateway does not listen on yet, since their address is not there"),
    ] = ()
    revocations: Annotated[
        RevocationsReport | None, Field(description="null: no list is in force, or an older gateway")
    ] = None
    limits: Annotated[LimitsReport, Field(description="an older gateway does not say")] = LimitsReport()
    wire: Annotated[WireReport, Field(description="an older gateway does not say")] = WireReport()
    physics: Annotated[
        str | None, Field(description="Zenoh id of the process that simulates the robot's body; null: none does")
    ] = None


class ChangingState(Report):
    """What changes all the time."""

    config: Annotated[str, Field(max_length=8, description="of the ConfigReport that belongs to it")] = ""
    mode: AnyMode
    time: AwareDatetime
    uptime_s: float
    commands: CommandCounts
    spi: SpiCounts
    watchdog: WatchdogCounts
    estop: Annotated[Count, Field(description="the number of the latest emergency stop; 0 before the first")] = 0
    estop_source: Annotated[str | None, Field(description="who requested that, as far as known")] = None
    estop_since: Annotated[AwareDatetime | None, Field(description="since when it is engaged; null: it is not")] = None
    estop_fault: Annotated[
        str | None, Field(description="why it may not outlast a restart, or counts as engaged; null: nothing is wrong")
    ] = None
    lease: Annotated[LeaseReport, Field(description="who is driving; an older gateway does not say")] = LeaseReport()
    buttons: Annotated[ButtonsAlive, Field(description="an older gateway has none")] = ButtonsAlive()
    loop_lag_us: Annotated[LoopLag, Field(description="an older gateway does not say")] = LoopLag()
    incident: Annotated[str | None, Field(description="id of the latest incident in the black box")] = None
    controller: Annotated[ControllerReport, Field(description="an older gateway does not say")] = ControllerReport()
    battery: Annotated[Battery | None, Field(description="null: the robot does not tell, or an older gateway")] = None
    power: Annotated[PowerReport | None, Field(description="null: no power board, or an older gateway")] = None


class GatewayState(ChangingState, ConfigReport):
    """A StateReport and its ConfigReport, joined: what programs get, and what recordings contain."""

    legs: tuple[LegReport, ...]
    spi: SpiReport
    watchdog: WatchdogReport
    buttons: ButtonsReport = ButtonsReport()

    def leg(self, number: int) -> LegReport:
        """The report of one leg, 1 to 6. Raises KeyError for a leg that the state has not."""
        return {each.leg: each for each in self.legs}[number]

    def angles(self, unit: Literal["deg", "rad"] = "deg") -> Any:
        """The commanded angles, 6×3: a numpy array (NaN for a stopped servo); tuples where numpy is missing."""
        turn = math.radians if unit == "rad" else float
        rows = tuple(tuple(turn(math.nan if a is None else a) for a in leg.angles_deg) for leg in self.legs)
        try:
            import numpy  # noqa: PLC0415  # no dependency: notebooks have it
        except ImportError:
            return rows
        return numpy.array(rows)

    def __repr__(self) -> str:
        running = [each.leg for each in self.legs if each.running]
        return f"<GatewayState {self.mode}, legs that run: {running or 'none'}, up {self.uptime_s:.0f} s>"

    __str__ = __repr__


class Event(Report):
    """The payload of `hexapod/event`."""

    time: AwareDatetime
    kind: AnyKind
    source: str | None
    key: str | None
    reason: AnyReason | None
    detail: str
    left_out: Count = 0
    legs: Annotated[
        tuple[int, ...], Field(description="the legs that it is about, ascending; an older gateway does not say")
    ] = ()
    incident: Annotated[str | None, Field(description="id of the incident that it belongs to, in the black box")] = None


class FrameRecord(Report):
    """The payload of `hexapod/frame`: one frame written to SPI, in hex, framing left out."""

    time: AwareDatetime
    monotonic_ns: int
    bytes: str
    cause: AnyCause


class SimulatedServo(Report):
    """Angle of a simulated servo, as in commands, and its torque against the load."""

    angle_deg: float
    torque_nm: float


class BodyReport(Report):
    """The payload of `hexapod/sim/body`: the pose of a simulated robot, 30 times a second.

    In the ground's frame: x forward and y left at the start, z up. `feet`: which of legs 1 to 6 touch the ground.
    """

    time: AwareDatetime
    position_m: tuple[float, float, float]
    orientation_xyzw: tuple[float, float, float, float]
    velocity_m_s: tuple[float, float, float]
    upright: bool
    feet: tuple[bool, bool, bool, bool, bool, bool]
    servos: dict[str, SimulatedServo]
    terrain: Annotated[str, Field(description="the ground, as `run --terrain` names it")] = "flat"
    real_time_factor: Annotated[float, Field(ge=0, description="below 1 the machine is too slow")] = 1.0
