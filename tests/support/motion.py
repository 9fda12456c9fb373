"""What a judge of the supervisor demands of motion that takes time: limited speeds, and landings. See `oracle.py`."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from gateway.core.events import Transmit
from gateway.core.landing import Landing
from gateway.core.leg import Rules
from gateway.core.pacing import NS_PER_S
from gateway.protocol.frames import Op
from tests.support.history import ServoHistory, demand


def stepped(servo: ServoHistory, servo_id: int, angle_cdeg: int, target_cdeg: int, now_ns: int, rules: Rules) -> None:
    """A frame takes a servo to `angle_cdeg`, towards its target. Raise Violation where it is too far or too little."""
    speed_cdeg_s = rules.max_speed_cdeg_s.get(servo_id)
    if speed_cdeg_s is None or servo.written_cdeg is None:
        demand(angle_cdeg == target_cdeg, f"{servo_id}: the newest target is sent")
        return
    most_cdeg = speed_cdeg_s * (now_ns - servo.said_ns) // NS_PER_S
    gone_cdeg, way_cdeg = angle_cdeg - servo.written_cdeg, target_cdeg - servo.written_cdeg
    demand(abs(gone_cdeg) <= most_cdeg + 1, f"{servo_id} goes no faster than its speed: {gone_cdeg}, not {most_cdeg}")
    on_its_way = gone_cdeg * way_cdeg >= 0 and abs(gone_cdeg) <= abs(way_cdeg)
    demand(on_its_way, f"{servo_id} goes towards the newest target")
    demand(gone_cdeg == way_cdeg or abs(gone_cdeg) >= most_cdeg, f"{servo_id} goes as far as its speed allows")
    servo.bound_cdeg = None if gone_cdeg == way_cdeg else target_cdeg


@dataclass(frozen=True, slots=True)
class LandingHistory:
    """A landing: when it began and must end, and for each running servo where it was and where it goes."""

    began_ns: int
    ends_ns: int
    ways_cdeg: Mapping[int, tuple[int, int]]

    def key(self, now_ns: int) -> tuple[object, ...]:
        """What of it still matters."""
        return now_ns - self.began_ns, self.ends_ns - now_ns, tuple(self.ways_cdeg.items())

    def judge(self, transmit: Transmit, servos: Mapping[int, ServoHistory], now_ns: int, rules: Rules) -> None:
        """A frame of a landing: running servos only, each on its straight line, or told again where it is."""
        for servo_id, op in transmit.frame.servos:
            servo = servos[servo_id]
            if op.op is Op.STOP:
                demand(not servo.on, f"{servo_id} is stopped by its landing before it ends")
                continue
            demand(servo.on and op.op is Op.SET, f"{servo_id} is started by a landing")
            first, last = self.ways_cdeg[servo_id]
            length_ns = max(1, self.ends_ns - self.began_ns - 2 * rules.period_ns)
            part = min(Fraction(1), Fraction(now_ns - self.began_ns, length_ns))
            off_cdeg = abs(first + (last - first) * part - op.angle_cdeg)
            if servo_id in rules.max_speed_cdeg_s and op.angle_cdeg != servo.written_cdeg:
                line_cdeg = round(first + (last - first) * part)
                stepped(servo, servo_id, op.angle_cdeg, op.angle_cdeg, now_ns, rules)
                between = sorted((servo.written_cdeg or 0, line_cdeg))
                demand(between[0] - 1 <= op.angle_cdeg <= between[1] + 1, f"{servo_id} follows its line")
            else:
                demand(off_cdeg <= 1 or op.angle_cdeg == servo.written_cdeg, f"{servo_id} leaves its straight line")
            servo.written_cdeg, servo.said_ns, servo.bound_cdeg = op.angle_cdeg, now_ns, None


def landing_key(landing: Landing, now_ns: int) -> tuple[object, ...]:
    """What of a supervisor's landing can still matter, relative to now."""
    times = (at_ns - now_ns for at_ns in (landing.began_ns, landing.arrives_ns, landing.ends_ns))
    return *times, tuple(landing.ways_cdeg.items())
