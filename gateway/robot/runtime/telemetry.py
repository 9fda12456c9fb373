"""Keeps the newest values that the robot measured, and makes the payload of `hexapod/telemetry` from them."""

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from gateway.model import power_board
from gateway.model.elkapod import Measured
from gateway.model.telemetry import battery_of, report_of
from gateway.robot.core.message import Outbox, Reply
from gateway.robot.power.board import Status
from gateway.robot.runtime.event_publisher import wall_clock
from gateway.robot.runtime.supply import RobotSupply
from schemas import keys
from schemas.telemetry import Battery, PowerReport, ServoTelemetry, Supply, Telemetry

_CONVERTERS: Final = (power_board.CONVERTERS_1_TO_3_MV, power_board.CONVERTERS_4_5_MV)


class Measurement(NamedTuple):
    """Measured values, and when they came, in ns of the monotonic clock."""

    values: Measured
    ns: int


class LatestTelemetry:
    """The newest values; nothing, until a robot that measures has sent some. Written by the owner of the state.

    Older ones stay when the controller falls silent: their age shows this, and a fault of the bus is reported apart.
    """

    def __init__(self, outbox: Outbox, clock: Callable[[], int], supply: RobotSupply | None) -> None:
        self._outbox = outbox
        self._clock = clock
        self._supply = supply
        self.newest: Measurement | None = None
        """Replaced as a whole, so that a thread that owns nothing may read it, too."""

    def note(self, values: Measured, now_ns: int) -> None:
        """Take what came at this time."""
        self.newest = Measurement(values, now_ns)

    @property
    def battery(self) -> Battery | None:
        """For the state."""
        return None if self.newest is None else battery_of(self.newest.values)

    def power(self) -> PowerReport | None:
        """Return the power board's report; None: there is no board. Reading it needs no owner."""
        return None if self._supply is None else self._supply.report(self._clock())

    def publish(self) -> None:
        """Publish what the robot measures, if it does."""
        report = self.report()
        if report is not None:
            self._outbox.publish(keys.TELEMETRY, report)

    def answer(self, reply: Reply) -> None:
        """Answer a `get`. Where nothing was measured there is no answer, and the asker's question just ends.

        A robot that measures nothing, one that has not measured yet, and a gateway of an older version look the same:
        there are no values. An answer without any would look like some.
        """
        report = self.report()
        if report is not None:
            reply(report.model_dump_json().encode())

    def age_s(self, since_ns: int | None) -> float | None:
        """How long ago something came; None: it never did. Reading it needs no owner."""
        return None if since_ns is None else (self._clock() - since_ns) / 1e9

    def report(self) -> Telemetry | None:
        """What the robot and its power board measure; None: nothing. Reading it needs no owner."""
        now_ns = self._clock()
        board = {} if self._supply is None else board_values(self._supply.status, now_ns)
        if self.newest is None:
            return Telemetry.model_validate({"time": wall_clock(), **board}) if board else None
        report = report_of(self.newest.values, wall_clock(), max(0, now_ns - self.newest.ns) / 1e6)
        oldest_ms = max(report.age_ms, board.get("age_ms", 0.0))
        return report.model_copy(update={**board, "age_ms": oldest_ms})


def board_values(status: Status, now_ns: int) -> Mapping[str, Any]:
    """What a power board measures, by its names in `Telemetry`; empty: nothing yet."""
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
