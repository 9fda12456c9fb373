"""What the 18 servos of a simulated robot would draw from their power board. Pure.

Nobody has measured a servo of the robot: all currents are assumed (gateway/model/servo.py). A fed servo that is sent
nowhere takes what its electronics take. Without a simulated body, one that is driven carries its share of the robot,
and takes more while it moves. With one, its current follows from its torque.
"""

from collections.abc import Mapping, Sequence
from typing import Final

from gateway.model.servo import A_PER_NM, IDLE_A, MOVING_A, NO_LOAD_DEG_S
from schemas.robot import SERVO_IDS

WAITS_MA: Final = 8.0
HOLDS_MA: Final = 200.0
"""Its share of a robot that stands. More than a servo at rest may draw, so one that goes on holding is noticed."""


class SimulatedDraw:
    """The currents, in mA by servo id. Times are of one monotonic clock."""

    def __init__(self) -> None:
        self._sent_deg: dict[int, float | None] = dict.fromkeys(SERVO_IDS)
        self._arrives_ns = dict.fromkeys(SERVO_IDS, 0)

    def draw_ma(
        self, sent_deg: Mapping[int, float | None], torques_nm: Sequence[float], now_ns: int
    ) -> dict[int, float]:
        """Of servos that are sent there now (None: off). `torques_nm`: a body's, in the order of SERVO_IDS, or none."""
        drawn = {}
        for place, servo_id in enumerate(SERVO_IDS):
            angle_deg, before_deg = sent_deg[servo_id], self._sent_deg[servo_id]
            if angle_deg is not None and angle_deg != before_deg:
                way_deg = abs(angle_deg - (90.0 if before_deg is None else before_deg))
                self._arrives_ns[servo_id] = now_ns + round(way_deg / NO_LOAD_DEG_S * 1e9)
            if angle_deg is None:
                drawn[servo_id] = WAITS_MA
            elif torques_nm:
                drawn[servo_id] = 1000 * (IDLE_A + A_PER_NM * abs(torques_nm[place]))
            else:
                drawn[servo_id] = HOLDS_MA + (1000 * MOVING_A if now_ns < self._arrives_ns[servo_id] else 0.0)
            self._sent_deg[servo_id] = angle_deg
        return drawn
