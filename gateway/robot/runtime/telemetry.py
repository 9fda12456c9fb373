"""Keeps the newest values that the robot measured, and makes the payload of `hexapod/telemetry` from them."""

from typing import NamedTuple

from gateway.model.elkapod import Measured
from gateway.model.telemetry import battery_of, report_of
from gateway.robot.core.message import Reply
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

    def report(self, now_ns: int) -> Telemetry | None:
        """The report at this time; None: nothing was measured."""
        if self.newest is None:
            return None
        return report_of(self.newest.values, wall_clock(), max(0, now_ns - self.newest.ns) / 1e6)

    def answer(self, reply: Reply, now_ns: int) -> None:
        """Answer a `get`. Where nothing was measured there is no answer, and the asker's question just ends.

        A robot that measures nothing, one that has not measured yet, and a gateway of an older version look the same:
        there are no values. An answer without any would look like some.
        """
        report = self.report(now_ns)
        if report is not None:
            reply(report.model_dump_json().encode())
