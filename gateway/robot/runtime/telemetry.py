"""What the robot measures, as it is published. Written by the state's owner."""

from gateway.model.elkapod import Measured
from gateway.model.measurements import battery_of, telemetry_of
from gateway.robot.runtime.report import wall_clock
from schemas.telemetry import Battery, Telemetry


class MeasuredReports:
    """The newest measurement of one run; None before the first, and of a robot that measures nothing."""

    def __init__(self) -> None:
        self.newest: Measured | None = None
        self._ns = 0

    def note(self, values: Measured, now_ns: int) -> None:
        """The controller has answered with these."""
        self.newest, self._ns = values, now_ns

    def report(self, now_ns: int) -> Telemetry | None:
        """The payload of `hexapod/telemetry`."""
        return None if self.newest is None else telemetry_of(self.newest, wall_clock(), (now_ns - self._ns) / 1e6)

    @property
    def battery(self) -> Battery | None:
        """For the state."""
        return None if self.newest is None else battery_of(self.newest)
