"""What the servos' currents show of their Stops. Pure: time is an argument.

A stopped servo that draws was not stopped on its wire; a running one that draws nothing is unplugged, or broken.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.robot.power.board import News
from schemas.telemetry import Kind

IDLE_MA: Final = 150
"""A fed servo at rest draws some 8 mA, and one that holds its share of a standing robot some 200 mA (assumed)."""
SETTLE_NS: Final = 300 * NS_PER_MS
"""Behind a Stop: a servo that swings out may draw, and its current is asked for every 140 ms."""
NOTHING_MA: Final = 5
"""A servo that is fed and at rest draws some 8 mA for its own electronics."""
SILENT_NS: Final = 1 * NS_PER_S
IN_A_ROW: Final = 2
"""Measurements that show a stopped servo's current, before its supply is taken for it: one may be wrong."""


@dataclass(slots=True)
class _Judged:
    running: bool
    since_ns: int
    nothing_since_ns: int | None = None
    drawing: int = 0
    reported: bool = False


class CurrentRules:
    """Compares what servos do with what they draw; each finding is reported once for each start and Stop."""

    def __init__(self) -> None:
        """Nothing was measured yet."""
        self._servos: dict[int, _Judged] = {}

    def measured(self, currents_ma: Mapping[int, float], running: frozenset[int], now_ns: int) -> list[News]:
        """Take new measurements, of the servos that run and those that do not; returns what to report."""
        news: list[News] = []
        for servo_id, ma in currents_ma.items():
            servo = self._servos.get(servo_id)
            if servo is None or servo.running is not (servo_id in running):
                servo = self._servos[servo_id] = _Judged(servo_id in running, now_ns)
            found = self._silent(servo, ma, now_ns) if servo.running else self._draws(servo, ma, now_ns)
            if found is not None and not servo.reported:
                servo.reported = True
                news.append(News(found, _sentence(found, servo_id, ma), frozenset({servo_id})))
        return news

    def _draws(self, servo: _Judged, ma: float, now_ns: int) -> Kind | None:
        too_much = ma > IDLE_MA and now_ns - servo.since_ns >= SETTLE_NS
        servo.drawing = servo.drawing + 1 if too_much else 0
        return Kind.SERVO_DRAWS if servo.drawing >= IN_A_ROW else None

    def _silent(self, servo: _Judged, ma: float, now_ns: int) -> Kind | None:
        if ma >= NOTHING_MA:
            servo.nothing_since_ns = None
            return None
        if servo.nothing_since_ns is None:
            servo.nothing_since_ns = now_ns
        return Kind.SERVO_SILENT if now_ns - servo.nothing_since_ns >= SILENT_NS else None


def _sentence(kind: Kind, servo_id: int, ma: float) -> str:
    if kind is Kind.SERVO_DRAWS:
        return f"servo {servo_id} is stopped and draws {ma:.0f} mA, more than {IDLE_MA} mA"
    return f"servo {servo_id} runs and has drawn nothing for 1 s: it is unplugged, or broken"
