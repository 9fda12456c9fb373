"""Judges the servos' Stops by their currents. Pure: time is an argument.

A stopped servo that draws current has not received its Stop. A running servo without current is unplugged or broken.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from gateway.allowance import NS_PER_MS, NS_PER_S
from gateway.robot.power.board import News
from schemas.telemetry import Kind

IDLE_MA: Final = 150
"""A powered servo at rest draws about 8 mA, one that bears its share of a standing robot about 200 mA (assumed)."""
SETTLE_NS: Final = 300 * NS_PER_MS
"""After a Stop a servo may draw current while it comes to rest. Its current is measured every 140 ms."""
NOTHING_MA: Final = 5
"""Below the 8 mA of a powered servo's electronics."""
SILENT_NS: Final = 1 * NS_PER_S
IN_A_ROW: Final = 2
"""Measurements of a stopped servo's current before its power is cut, since one may be wrong."""


@dataclass(slots=True)
class _Judged:
    running: bool
    since_ns: int
    nothing_since_ns: int | None = None
    drawing: int = 0  # mutants accepted (Step): the first measurement sets it, before SETTLE_NS
    reported: bool = False


class CurrentRules:
    """Compares the servos' currents with their state. Each finding is reported once for each start and Stop."""

    def __init__(self) -> None:
        self._servos: dict[int, _Judged] = {}

    def measured(self, currents_ma: Mapping[int, float], running: frozenset[int], now_ns: int) -> list[News]:
        """Take new currents in mA. `running` are the servos that run. Return the events to report."""
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
