"""The state of a gateway, as programs and recordings read it."""

import math
from typing import Annotated, Any, Literal

from pydantic import AwareDatetime, Field

from schemas.config import ButtonsConfig, ConfigReport, SpiConfig, WatchdogConfig
from schemas.report import CUT, Count, Report
from schemas.telemetry import Battery
from schemas.words import AnyMode, AnyWatchdogState


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


class ButtonsAlive(Report):
    """The stop buttons that are alive."""

    alive: Annotated[Count, Field(description="certificates (or names) with a button that is alive and counts")] = 0
    names: Annotated[tuple[str, ...], Field(description="buttons that are alive, at most 16")] = ()


class ButtonsReport(ButtonsAlive, ButtonsConfig):
    """Stop buttons; nothing moves while fewer are alive than required."""


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
