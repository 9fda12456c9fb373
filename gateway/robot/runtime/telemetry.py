"""Keeps the robot's newest measurements, and makes the payload of `hexapod/telemetry` from them."""

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from gateway.model import power_board
from gateway.model.elkapod import Measured
from gateway.model.telemetry import report_of
from gateway.robot.core.message import Outbox, Reply
from gateway.robot.power.board import Status
from gateway.robot.runtime.event_publisher import wall_clock
from gateway.robot.runtime.supply import RobotSupply
from schemas import keys
from schemas.telemetry import PowerReport, ServoTelemetry, Supply, Telemetry

_CONVERTERS: Final = (power_board.CONVERTERS_1_TO_3_MV, power_board.CONVERTERS_4_5_MV)


class Measurement(NamedTuple):
    """Measured values, and when they were received, in ns of the monotonic clock."""

    values: Measured
    ns: int


class LatestTelemetry:
    """The newest measurements, if any. The owner of the state writes them.

    They stay when the controller falls silent; their age shows that, and a bus fault is reported separately.
    """

    def __init__(self, outbox: Outbox, clock: Callable[[], int], supply: RobotSupply | None) -> None:
        self._outbox = outbox
        self._clock = clock
        self._supply = supply
        self.newest: Measurement | None = None
        """Replaced as a whole, so that any thread may read it."""

    def note(self, values: Measured, now_ns: int) -> None:
        """Take values received at `now_ns`."""
        self.newest = Measurement(values, now_ns)

    def power(self) -> PowerReport | None:
        """Return the power board's report, or None without a board. For any thread."""
        return None if self._supply is None else self._supply.report(self._clock())

    def publish(self) -> None:
        report = self.report()
        if report is not None:
            self._outbox.publish(keys.TELEMETRY, report)

    def answer(self, reply: Reply) -> None:
        """Answer a `get` with the measurements. Without any, the query ends without an answer.

        So a robot that measures nothing, one that has not measured yet, and an older gateway look the same.
        """
        report = self.report()
        if report is not None:
            reply(report.model_dump_json().encode())

    def report(self) -> Telemetry | None:
        """Return the measurements of the robot and its power board, or None without any. For any thread."""
        now_ns = self._clock()
        board = {} if self._supply is None else board_values(self._supply.line.status, now_ns)
        if self.newest is None:
            return Telemetry.model_validate({"time": wall_clock(), **board}) if board else None
        report = report_of(self.newest.values, wall_clock(), max(0, now_ns - self.newest.ns) / 1e6)
        oldest_ms = max(report.age_ms, board.get("age_ms", 0.0))
        return report.model_copy(update={**board, "age_ms": oldest_ms})


def board_values(status: Status, now_ns: int) -> Mapping[str, Any]:
    """Return a power board's measurements by their names in `Telemetry`; empty before the first."""
    if status.answered_ns is None:
        return {}
    found: dict[str, Any] = {"age_ms": max(0, now_ns - status.answered_ns) / 1e6}
    if status.currents_ma:
        found["servos"] = {
            str(servo_id): ServoTelemetry(supplied=servo_id in status.supplied, current_a=ma / 1000)
            for servo_id, ma in sorted(status.currents_ma.items())
        }
    rails = status.rails
    currents, volts = rails.get(power_board.STANDBY_SUPPLY_MA), rails.get(power_board.SUPPLY_BATTERY_MV)
    if currents is not None and volts is not None:
        found["supply"] = Supply(voltage_v=volts[0] / 1000, current_a=currents[1] / 1000)
    converters = [rails.get(each) for each in _CONVERTERS]
    if None not in converters:
        found["converters_v"] = tuple(mv / 1000 for each in converters if each is not None for mv in each)
    temperatures_c = rails.get(power_board.TEMPERATURES_C)
    if temperatures_c is not None:
        found["board_temperatures_c"] = temperatures_c
    return found
