"""Keeps the newest values that the robot measured, and makes the payload of `hexapod/telemetry` from them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from gateway.model.elkapod import Measured
from gateway.model.telemetry import battery_of, report_of
from gateway.robot.runtime.report import wall_clock
from schemas.telemetry import Battery, Telemetry


class Measurement(NamedTuple):
    """Measured values, and when they came, in ns of the monotonic clock."""

    values: Measured
    ns: int


class LatestTelemetry:
    """The newest values; nothing, until a robot that measures has sent some. Written by the owner of the state.

    Older ones stay when the controller falls silent: their age says so, and a fault of the bus is reported by itself.
    """

    def __init__(self) -> None:
        self.newest: Measurement | None = None
        """Replaced as a whole, so that a thread that owns nothing may read it, too."""

    def note(self, values: Measured, now_ns: int) -> None:
        """Take what came at this time."""
        self.newest = Measurement(values, now_ns)

    @property
    def battery(self) -> Battery | None:
        """For the state."""
        return None if self.newest is None else battery_of(self.newest.values)

    def report(self, now_ns: int, board: Mapping[str, Any]) -> Telemetry | None:
        """The report at this time, with what a power board measures; None: nothing was measured."""
        if self.newest is None:
            return Telemetry.model_validate({"time": wall_clock(), **board}) if board else None
        report = report_of(self.newest.values, wall_clock(), max(0, now_ns - self.newest.ns) / 1e6)
        oldest_ms = max(report.age_ms, board.get("age_ms", 0.0))
        return report.model_copy(update={**board, "age_ms": oldest_ms})
