"""Payloads that go out: acknowledgements, state, events and frame records."""

import math
from collections.abc import Iterator
from enum import StrEnum
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

T = TypeVar("T")
Count = Annotated[int, Field(ge=0)]
Six = tuple[T, T, T, T, T, T]
"""A value for each leg, 1 to 6."""
CUT = "…"
"""Ends a text that was cut."""


class Report(BaseModel):
    """Frozen and open: fields are only ever added, and readers ignore unknown ones.

    A reader that rejected unknown fields would show NOT STOPPED after a successful stop. A report's validator is made
    at its first use, so the service writes its first Stops before.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", defer_build=True)


class Value(StrEnum):
    """A word of the interface, and its meaning."""

    meaning: str

    def __new__(cls, value: str, meaning: str = "") -> Self:
        member = str.__new__(cls, value)
        member._value_, member.meaning = value, meaning
        return member


class Reason(Value):
    """Why a command was rejected."""

    TOO_LARGE = "too_large", "the payload has more than 4096 bytes"
    BAD_ENCODING = "bad_encoding", "the encoding is not JSON"
    MALFORMED = "malformed", "the payload is not JSON"
    INVALID = "invalid", "a field is missing, unknown or out of range, or there is no such key"
    SERVO_STOPPED = "servo_stopped", "a `set` names a stopped servo, a Stop arrived too, or its calibration is in doubt"
    JOINT_LIMIT = "joint_limit", "the angle is outside the servo's limits, or is never sent"
    STALE = "stale", "it was delayed for too long, belongs to a burst, names an old calibration, or repeats a check-in"
    ESTOPPED = "estopped", "the emergency stop is engaged, or a reset names another one"
    BUS_FAULT = "bus_fault", "the controller cannot be reached"
    STOPPING = "stopping", "the gateway ends"
    NOT_HOLDER = "not_holder", "somebody else holds the lease, or its own has ended"
    NO_LEASE = "no_lease", "nobody holds the lease, and it is required or asked for"
    LEASE_HELD = "lease_held", "the lease is not free"
    LEASE_DENIED = "lease_denied", "the name is not proved, or the lease cannot be taken or handed over"
    LANDING = "landing", "the robot lands"
    OVERFLOW = "overflow", "messages of its key were lost, perhaps a Stop"
    REVOCATION_DENIED = "revocation_denied", "the list is signed by another CA, not newer, or cannot be kept"
    NO_BUTTON = "no_button", "too few buttons are alive"
    UNKNOWN_BUTTON = "unknown_button", "no button has this token"
    BUTTON_DENIED = "button_denied", "the name is not proved, or its places are taken"
    BATTERY_LOW = "battery_low", "it starts a servo on a low battery"
    WHOLE_ROBOT = "whole_robot", "only all 18 servos together can be started"
    FALLEN = "fallen", "it starts or sets a servo while the body tilts too far"
    NO_POWER = "no_power", "the power board does not answer or does not feed that servo"


class Mode(Value):
    """What the gateway as a whole is doing."""

    STARTING = "starting", "the device is not open yet"
    IDLE = "idle", "commands are accepted; no servo runs"
    ACTIVE = "active", "a servo runs"
    ESTOPPED = "estopped", "the emergency stop is engaged"
    BUS_FAULT = "bus_fault", "the device failed and is being reopened"
    STOPPING = "stopping", "the gateway ends"


class Kind(Value):
    """What an event reports, and whether legs stop by it."""

    stops: bool

    def __new__(cls, value: str, meaning: str = "", stops: bool = False) -> Self:
        member = str.__new__(cls, value)
        member._value_, member.meaning, member.stops = value, meaning, stops
        return member

    STARTED = "started", "commands are accepted from now on"
    COMMAND_REJECTED = "command_rejected", "a command took no effect"
    WATCHDOG_EXPIRED = "watchdog_expired", "a leg was silent and is stopped", True
    ESTOP_ENGAGED = "estop_engaged", "an emergency stop was requested", True
    ESTOP_RESET = "estop_reset", "the emergency stop was left"
    ESTOP_KEPT = "estop_kept", "the gateway started with the emergency stop engaged"
    ESTOP_NOT_KEPT = "estop_not_kept", "the emergency stop, or its end, could not be written to disk"
    BUS_FAULT = "bus_fault", "a transfer failed", True
    BUS_RECOVERED = "bus_recovered", "the device answers again; all servos are stopped"
    STOPPING = "stopping", "the gateway ends", True
    STOPPED_OUTSIDE = "stopped_outside", "`stop-servos` stopped the servos", True
    LEGS_STOPPED = "legs_stopped", "a Stop reached `legs`, which ran or waited to start; `cause` is why", True
    SOURCE_CHANGED = "source_changed", "another source commands or stops a running leg"
    LEASE_ACQUIRED = "lease_acquired", "somebody drives from now on"
    LEASE_RELEASED = "lease_released", "the holder released the lease or handed it over"
    LEASE_EXPIRED = "lease_expired", "the holder, or the nominee, was silent for too long"
    LEASE_TAKEN = "lease_taken", "somebody stopped all legs and took the lease", True
    LEASE_ASKED = "lease_asked", "somebody asks the holder for the lease"
    LANDING = "landing", "the robot goes to its landing pose; `watchdog_expired` follows"
    CALIBRATED = "calibrated", "a changed calibration is in force and kept"
    OVERFLOW = "overflow", "messages of one key were lost, perhaps a Stop: its servos are stopped", True
    BUS_MEDDLED = "bus_meddled", "another program changed the SPI settings; they are restored, and `bus_fault` follows"
    REVOKED = "revoked", "a newer list is in force: the gateway restarts; or the stored list was older"
    BUTTON_REGISTERED = "button_registered", "a button is registered and replaces an older one of its name"
    BUTTON_SILENT = "button_silent", "a button was silent for too long"
    BUTTON_LEFT = "button_left", "a button left"
    BUTTON_RETURNED = "button_returned", "a silent button checks in again"
    CONTROLLER_SILENT = "controller_silent", "heartbeats or answers are missing: all servos are stopped", True
    CONTROLLER_RESTARTED = "controller_restarted", "the controller may have restarted: all servos are stopped", True
    CONTROLLER_RETURNED = "controller_returned", "heartbeats and answers arrive again"
    BATTERY_LOW = "battery_low", "starts are rejected; running servos go on"
    FALLEN = "fallen", "the body tilted too far: all legs stop or land", True
    POWER_CUT = "power_cut", "the power board is to cut the supply of these legs"
    POWER_RESTORED = "power_restored", "servos are fed again"
    POWER_UNCONFIRMED = "power_unconfirmed", "the board has not confirmed the supply off: **switch it off by hand**"
    POWER_FAULT = "power_fault", "a fault of the board, or another program switches servos through it"
    SERVO_DRAWS = "servo_draws", "a stopped servo draws current"
    SERVO_SILENT = "servo_silent", "a running servo draws nothing for 1 s"
    OFF_BUTTON = "off_button", "the board's off button was pressed: all legs are stopped", True


class Cause(Value):
    """Why a frame was written, or legs were stopped."""

    COMMAND = "command", "for a command"
    WATCHDOG = "watchdog", "a leg was silent, or too few buttons were alive"
    ESTOP = "estop", "for an emergency stop"
    STARTUP = "startup", "the device was opened"
    SHUTDOWN = "shutdown", "the gateway ends"
    REPEAT = "repeat", "repeats a Stop"


class WatchdogState(Value):
    """State of a leg's watchdog."""

    IDLE = "idle", "no servo runs or waits to start"
    ARMED = "armed", "silence will stop the leg"
    EXPIRED = "expired", "silence has stopped the leg"


OrText = Field(union_mode="left_to_right")
"""For values that later versions may extend: an unknown one is read as text."""
AnyReason = Annotated[Reason | str, OrText]
AnyMode = Annotated[Mode | str, OrText]
AnyKind = Annotated[Kind | str, OrText]
AnyCause = Annotated[Cause | str, OrText]
AnyWatchdogState = Annotated[WatchdogState | str, OrText]


class Sparse(Report):
    """A report whose null fields are left out of its JSON and its repr."""

    @model_serializer(mode="wrap")
    def _without_nulls(self, handler: SerializerFunctionWrapHandler) -> dict[str, object]:
        return {name: value for name, value in handler(self).items() if value is not None}

    def __repr_args__(self) -> Iterator[tuple[str | None, object]]:
        return ((name, value) for name, value in super().__repr_args__() if value is not None)


class Answer(Sparse):
    """What every reply to a request contains."""

    accepted: Annotated[bool, Field(description="whether the request took effect")]
    reason: Annotated[AnyReason | None, Field(description="why it was rejected")] = None
    detail: Annotated[str | None, Field(description="one sentence")] = None

    def or_raise(self) -> Self:
        """Return itself. Raises RejectedError with the gateway's reason if the request was rejected."""
        if not self.accepted:
            from gateway.errors import RejectedError  # noqa: PLC0415  # schemas alone need no gateway

            raise RejectedError(str(self.reason or ""), self.detail or "no reason was given")
        return self


class Ack(Answer):
    """The reply to an acknowledged command; null fields are left out of the JSON."""

    coalesced: Annotated[Literal[True] | None, Field(description="a newer command replaced it before its frame")] = None
    written: Annotated[
        list[int] | None,
        Field(description="if not accepted: legs already written (*Answered in part*)"),
    ] = None
    stopped: Annotated[
        Literal[True] | None,
        Field(description="if not accepted: its servos are stopped anyway"),
    ] = None
    stop_frames: Annotated[Count | None, Field(description="of an emergency stop: Stop frames written")] = None
    estop: Annotated[Count | None, Field(description="of an emergency stop: its number")] = None
    kept: Annotated[
        bool | None,
        Field(description="of an emergency stop: whether it was on the disk when this left; null: no state folder"),
    ] = None
    latency_us: Annotated[
        float | None, Field(ge=0, description="of an emergency stop: request to last Stop written")
    ] = None
    confirmed: Annotated[bool | None, Field(description="of a Stop: whether the power board confirmed it")] = None
    confirmed_ms: Annotated[float | None, Field(ge=0, description="from the command to that confirmation")] = None

    def __bool__(self) -> bool:
        """Whether the command was accepted."""
        return self.accepted


class ServoReport(Report):
    """One servo as last commanded; nothing comes back from the controller."""

    id: int
    running: bool
    angle_deg: float | None
    target_deg: Annotated[float | None, Field(description="where it is to go, if it runs or waits to start")] = None


class LegReport(Report):
    """One leg. `age_ms`: since an accepted command started or set one of its servos; null before the first.

    `source`: of the command in force; null if it has none, or if the gateway has stopped the leg.
    """

    leg: int
    watchdog: AnyWatchdogState
    age_ms: float | None
    servos: tuple[ServoReport, ServoReport, ServoReport]
    source: str | None = None
    source_id: str | None = None

    def is_of(self, source: str, source_id: str | None = None) -> bool:
        """Whether this sender's command is in force. A long name may be cut in the report, and an id be unknown."""
        shown, known = self.source or "", None not in (source_id, self.source_id)
        if known and source_id != self.source_id:
            return False
        begin = shown.removesuffix(CUT)
        return shown == source or (begin != shown and (known or begin != "") and source.startswith(begin))

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
    """Commands since the start. A coalesced command was accepted, then replaced by a newer one before its frame."""

    accepted: Annotated[Count, Field(description="since the start")]
    rejected: Annotated[Count, Field(description="since the start")]
    coalesced: Annotated[Count, Field(description="accepted, then replaced before the frame was written")]
    overflows: Annotated[Count, Field(description="times that messages of one key were lost before they were read")] = 0
    lost: Annotated[Count, Field(description="messages lost in these, at least")] = 0
    passed_over: Annotated[
        Count, Field(description="messages displaced by newer ones of the same key before they were read one by one")
    ] = 0


class SpiConfig(Report):
    """The SPI device."""

    device: Annotated[str, Field(description="the setting")]
    framing: Annotated[str, Field(description="the setting")]


class SpiCounts(Report):
    """Frames and faults since the start."""

    frames: Annotated[Count, Field(description="frames written")]
    errors: Annotated[Count, Field(description="transfers and openings that failed")]


class SpiReport(SpiCounts, SpiConfig):
    """The SPI device, its frames and faults since the start."""


class StopLatency(Report):
    """Microseconds from a watchdog's deadline to its Stop written; null before the first."""

    p50: Annotated[float | None, Field(description="deadline to Stop written, of the last thousand")]
    p99: Annotated[float | None, Field(description="deadline to Stop written, of the last thousand")]
    max: Annotated[float | None, Field(description="since the start")]


class LoopLag(Report):
    """Lateness of the gateway's timers in microseconds, since the start; percentiles are upper ends of buckets."""

    p50: Annotated[float | None, Field(description="lateness of timers since the start, rounded up")] = None
    p99: Annotated[float | None, Field(description="lateness of timers since the start, rounded up")] = None
    max: Annotated[float | None, Field(description="exact")] = None


class WatchdogConfig(Report):
    """The watchdog's settings."""

    timeout_ms: Annotated[float, Field(description="the setting")]
    landing_ms: Annotated[float, Field(description="the setting")] = 0.0


class WatchdogCounts(Report):
    """The watchdog's counters."""

    expirations: Annotated[Count, Field(description="legs stopped for silence")]
    stop_latency_us: StopLatency


class WatchdogReport(WatchdogCounts, WatchdogConfig):
    """The watchdog's settings and counters."""

    @property
    def stops_after_ms(self) -> float:
        """Longest time (ms) from a leg's last command to its Stop."""
        return self.timeout_ms + self.landing_ms


class LeaseReport(Report):
    """The lease. During a hand-over `holder` is who may acquire it, and `held_s` is null."""

    holder: Annotated[str | None, Field(description="who drives; during a handover, the next driver")] = None
    verified: Annotated[bool, Field(description="whether a certificate proved that name")] = False
    held_s: Annotated[float | None, Field(description="since acquired; null: free, or handed over")] = None
    expires_in_ms: Annotated[float | None, Field(description="until it is free, unless renewed")] = None
    asked_by: Annotated[str | None, Field(description="who asked the holder last")] = None


class ButtonsConfig(Report):
    """How many stop buttons must be alive."""

    required: Annotated[Count, Field(description="the setting")] = 0


class ButtonsAlive(Report):
    """The stop buttons that are alive."""

    alive: Annotated[Count, Field(description="certificates (or names) with a button that is alive and counts")] = 0
    names: Annotated[tuple[str, ...], Field(description="buttons that are alive, at most 16")] = ()


class ButtonsReport(ButtonsAlive, ButtonsConfig):
    """Stop buttons; nothing moves while fewer are alive than required."""


class CalibrationReport(Report):
    """The calibration in force. Its numbers are on `hexapod/calibration`."""

    revision: Annotated[Count, Field(description="of the calibration in force")] = 0
    fault: Annotated[str | None, Field(description="why the file cannot be used; nothing can start then")] = None
    kept: Annotated[bool, Field(description="whether the next boot finds it")] = False


class TelemetryReport(Report):
    """What the gateway publishes besides the state."""

    frames: Annotated[bool | None, Field(description="whether `hexapod/frame` is published; null: unknown")] = None


class CertificateReport(Report):
    """The first of the gateway's certificates to expire."""

    file: Annotated[str, Field(description="that expires first")]
    expires: Annotated[AwareDatetime, Field(description="when")]


class RevocationsReport(Report):
    """The list of revoked certificates in force."""

    number: Annotated[int, Field(description="of the list in force")]
    date: Annotated[AwareDatetime, Field(description="when it was signed")]


class ServoLimitsReport(Report):
    """The settings' limits of one servo, in degrees as in commands; a speed of 0 is unlimited."""

    min_deg: Annotated[float, Field(description="the setting")] = 0.0
    max_deg: Annotated[float, Field(description="the setting")] = 180.0
    max_speed_deg_s: Annotated[float, Field(description="the setting; 0: unlimited")] = 0.0


class Battery(Report):
    """The robot's battery, as the controller measures it, else the power board."""

    voltage_v: Annotated[float, Field(description="as measured")]
    percent: Annotated[float | None, Field(description="as the controller sends it; null: by the power board")]


class Imu(Report):
    """The body's inertial sensor: orientation, angular velocity and acceleration."""

    orientation_wxyz: Annotated[tuple[float, float, float, float], Field(description="of the body, not normalised")]
    angular_velocity_rad_s: Annotated[tuple[float, float, float], Field(description="x, y, z in the sensor's frame")]
    linear_acceleration_m_s2: Annotated[tuple[float, float, float], Field(description="x, y, z, with gravity")]


class ServoTelemetry(Sparse):
    """What a power board measures of one servo."""

    supplied: Annotated[bool, Field(description="whether the power board feeds it")]
    current_a: Annotated[float | None, Field(description="its current")] = None


class Supply(Report):
    """What feeds the servos."""

    voltage_v: Annotated[float, Field(description="of the servos")]
    current_a: Annotated[float, Field(description="of all servos")]


class Telemetry(Sparse):
    """The payload of `hexapod/telemetry`: what the robot measures. Missing measurements are left out."""

    time: Annotated[AwareDatetime, Field(description="when it was published")]
    age_ms: Annotated[float, Field(ge=0, description="of the oldest of these values")]
    temperature_c: Annotated[float | None, Field(description="the controller's")] = None
    battery: Battery | None = None
    imu: Imu | None = None
    tilt_deg: Annotated[float | None, Field(description="of the body, 0 to 180, if the orientation is valid")] = None
    feet: Annotated[Six[float] | None, Field(description="forces, unit unknown")] = None
    servos: Annotated[dict[str, ServoTelemetry] | None, Field(description="by id, from the power board")] = None
    supply: Supply | None = None
    converters_v: Annotated[tuple[float, ...] | None, Field(description="the power board's converters")] = None
    board_temperatures_c: Annotated[tuple[float, ...] | None, Field(description="the power board's sensors")] = None


class WireReport(Report):
    """The wire to the controller, and what depends on it."""

    name: Annotated[str, Field(description="the setting `wire.name`")] = ""
    whole_robot: Annotated[bool, Field(description="only all servos together can be started and stopped")] = False
    measures: Annotated[bool, Field(description="telemetry comes back")] = False
    acknowledges: Annotated[bool, Field(description="the controller confirms each written frame")] = False
    supply_starts: Annotated[bool, Field(description="with a power board, supply starts a servo")] = False


class ControllerReport(Report):
    """The controller. If it sends nothing, `alive` is null."""

    alive: Annotated[bool | None, Field(description="whether it answers; null: this wire has no answers")] = None
    age_ms: Annotated[float | None, Field(description="since its last well-formed answer; null: none")] = None


class PowerReport(Report):
    """The board that feeds the servos, where the settings name one."""

    interface: Annotated[str, Field(description="the setting")]
    alive: Annotated[bool, Field(description="whether the board answers")]
    supplied: Annotated[tuple[int, ...], Field(description="servos fed, by its last answer")] = ()
    confirmed: Annotated[bool, Field(description="whether it confirmed every off that was requested")] = False
    age_ms: Annotated[float | None, Field(description="since its last answer; null: none")] = None


class LimitsReport(Report):
    """The settings' limits of legs and servos. The calibration's limits are on `hexapod/calibration`."""

    leg_rate_hz: Annotated[float, Field(description="the setting")] = 50.0
    max_age_ms: Annotated[float, Field(description="the setting; 0: any age")] = 500.0
    servos: Annotated[dict[str, ServoLimitsReport], Field(description="of all eighteen, by id")] = {}


class ConfigReport(Report):
    """The payload of `hexapod/config`: what seldom changes."""

    config: Annotated[str, Field(description="checksum of these values")] = ""
    version: Annotated[str, Field(description="the gateway's")]
    protocol: Annotated[str, Field(description="`1.0.0`")]
    simulated: Annotated[bool, Field(description="no real device")]
    spi: SpiConfig
    watchdog: WatchdogConfig
    buttons: Annotated[ButtonsConfig, Field(description="an older gateway has none")] = ButtonsConfig()
    calibration: Annotated[CalibrationReport, Field(description="an older gateway has none")] = CalibrationReport()
    telemetry: Annotated[TelemetryReport, Field(description="an older gateway lacks it")] = TelemetryReport()
    certificate: Annotated[CertificateReport | None, Field(description="null: none in use")] = None
    missing_endpoints: Annotated[tuple[str, ...], Field(description="not listened on yet: address is missing")] = ()
    revocations: Annotated[RevocationsReport | None, Field(description="null: no list in force")] = None
    limits: Annotated[LimitsReport, Field(description="an older gateway lacks it")] = LimitsReport()
    wire: Annotated[WireReport, Field(description="an older gateway lacks it")] = WireReport()
    physics: Annotated[str | None, Field(description="Zenoh id of the publisher of `hexapod/sim/body`")] = None


class ChangingState(Report):
    """What changes all the time."""

    config: Annotated[str, Field(max_length=8, description="checksum of the ConfigReport that belongs to it")] = ""
    mode: Annotated[AnyMode, Field(description="what the gateway does")]
    time: Annotated[AwareDatetime, Field(description="for people; no decision depends on it")]
    uptime_s: Annotated[float, Field(description="since the start")]
    commands: CommandCounts
    spi: SpiCounts
    watchdog: WatchdogCounts
    estop: Annotated[Count, Field(description="number of the latest emergency stop; 0: none yet")] = 0
    estop_source: Annotated[str | None, Field(description="who requested it, if known")] = None
    estop_since: Annotated[AwareDatetime | None, Field(description="null: not engaged")] = None
    estop_fault: Annotated[str | None, Field(description="why a restart may forget it, or it counts as engaged")] = None
    lease: Annotated[LeaseReport, Field(description="who is driving; an older gateway lacks it")] = LeaseReport()
    buttons: Annotated[ButtonsAlive, Field(description="an older gateway has none")] = ButtonsAlive()
    loop_lag_us: Annotated[LoopLag, Field(description="an older gateway lacks it")] = LoopLag()
    incident: Annotated[str | None, Field(description="id of the latest incident in the black box")] = None
    controller: Annotated[ControllerReport, Field(description="an older gateway lacks it")] = ControllerReport()
    battery: Annotated[Battery | None, Field(description="null: not measured")] = None
    power: Annotated[PowerReport | None, Field(description="null: no power board")] = None


class GatewayState(ChangingState, ConfigReport):
    """A StateReport and its ConfigReport, joined, for programs and recordings."""

    legs: tuple[LegReport, ...]
    spi: SpiReport
    watchdog: WatchdogReport
    buttons: ButtonsReport = ButtonsReport()

    def leg(self, number: int) -> LegReport:
        """Return the report of one leg, 1 to 6. Raises KeyError if the state has no such leg."""
        return {each.leg: each for each in self.legs}[number]

    def angles(self, unit: Literal["deg", "rad"] = "deg") -> Any:
        """Return the commanded angles, 6×3, NaN for a stopped servo: a numpy array, or tuples without numpy."""
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

    time: Annotated[AwareDatetime, Field(description="when")]
    kind: Annotated[AnyKind, Field(description="what happened")]
    source: Annotated[str | None, Field(description="the name of who caused it")]
    source_id: Annotated[str | None, Field(description="the Zenoh id of who caused it, if the message had it")] = None
    key: Annotated[str | None, Field(description="of the command")]
    reason: Annotated[AnyReason | None, Field(description="of a rejection or an overflow")]
    detail: Annotated[str, Field(description="one sentence")]
    left_out: Annotated[Count, Field(description="such events left out before this one (Behaviour *Events*)")] = 0
    legs: Annotated[tuple[int, ...], Field(description="legs that stop, land, change their source or are named")] = ()
    incident: Annotated[str | None, Field(description="id of its incident in the black box")] = None
    cause: Annotated[AnyCause | None, Field(description="of `legs_stopped`")] = None


class FrameRecord(Report):
    """The payload of `hexapod/frame`: one frame written to SPI."""

    time: Annotated[AwareDatetime, Field(description="when")]
    monotonic_ns: Annotated[int, Field(description="when, by the gateway's monotonic clock")]
    bytes: Annotated[str, Field(description="in hex, without framing")]
    cause: Annotated[AnyCause, Field(description="why it was written")]


class SimulatedServo(Report):
    """Angle of a simulated servo, as in commands, and its torque against the load."""

    angle_deg: Annotated[float, Field(description="its angle, as in commands")]
    torque_nm: Annotated[float, Field(description="against its load; 0: off")]


class BodyReport(Report):
    """The payload of `hexapod/sim/body`: the pose of a simulated robot, 30 times a second.

    In the ground's frame: x forward and y left at the start, z up. `feet`: which of legs 1 to 6 touch the ground.
    """

    time: Annotated[AwareDatetime, Field(description="when")]
    position_m: Annotated[tuple[float, float, float], Field(description="of the body's frame")]
    orientation_xyzw: Annotated[tuple[float, float, float, float], Field(description="unit quaternion, body to ground")]
    velocity_m_s: Annotated[tuple[float, float, float], Field(description="of the body")]
    upright: Annotated[bool, Field(description="leans by less than 45°")]
    feet: Annotated[Six[bool], Field(description="of legs 1 to 6: on the ground")]
    servos: Annotated[dict[str, SimulatedServo], Field(description="by id")]
    terrain: Annotated[str, Field(description="as `run --terrain` names it")] = "flat"
    real_time_factor: Annotated[float, Field(ge=0, description="below 1 the machine is too slow")] = 1.0
