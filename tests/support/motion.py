"""What a judge of the supervisor demands of motion that takes time: limited speeds, and landings. See `oracle.py`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gateway.model.frames import Op
from gateway.rate_limit import NS_PER_S
from gateway.robot.core.events import Transmit
from gateway.robot.core.rules import Rules
from tests.support.history import ServoHistory, demand

Gap = Callable[[int, int, int], tuple[int, int] | None]
"""Of a servo, and of where it goes from and to: `CalibrationHistory.gap`."""


def stepped(
    servo: ServoHistory, servo_id: int, angle_cdeg: int, target_cdeg: int, now_ns: int, rules: Rules, gap: Gap
) -> None:
    """A frame takes a servo to `angle_cdeg`, towards its target. Raise Violation where it is too far or too little."""
    stood_cdeg = servo.written_cdeg
    if servo.want is not None and not servo.on:
        stood_cdeg, servo.said_ns = servo.want.from_cdeg, now_ns
        servo.eases = rules.takeover_cdeg_s > 0 and stood_cdeg is not None
    speeds = [rules.max_speed_cdeg_s.get(servo_id), rules.takeover_cdeg_s if servo.eases else None]
    speed_cdeg_s = min((each for each in speeds if each is not None), default=None)
    if speed_cdeg_s is None or stood_cdeg is None:
        demand(angle_cdeg == target_cdeg, f"{servo_id}: the newest target is sent")
        return
    slot_cdeg = -(-speed_cdeg_s * rules.period_ns // NS_PER_S)
    most_cdeg = min(speed_cdeg_s * (now_ns - servo.said_ns) // NS_PER_S, slot_cdeg)
    gone_cdeg, way_cdeg = angle_cdeg - stood_cdeg, target_cdeg - stood_cdeg
    on_its_way = gone_cdeg * way_cdeg >= 0 and abs(gone_cdeg) <= abs(way_cdeg)
    demand(on_its_way, f"{servo_id} goes towards the newest target")
    edges = gap(servo_id, stood_cdeg, target_cdeg)
    if edges is None:
        servo.edge_ns = None
    elif angle_cdeg == edges[0]:  # it waits there until it would be beyond
        servo.edge_ns = servo.said_ns if servo.edge_ns is None else servo.edge_ns
    if edges is not None and gap(servo_id, angle_cdeg, target_cdeg) is None:
        since_ns = servo.said_ns if servo.edge_ns is None else servo.edge_ns
        beyond_cdeg, all_cdeg = abs(angle_cdeg - edges[1]), speed_cdeg_s * (now_ns - since_ns) // NS_PER_S
        demand(beyond_cdeg <= most_cdeg + 1, f"{servo_id} goes no faster than its speed behind the gap")
        demand(abs(gone_cdeg) <= all_cdeg + 1, f"{servo_id} goes across the gap no faster than its speed")
        servo.edge_ns = None
    else:
        what = f"{servo_id} goes no faster than its speed: {gone_cdeg}, not {most_cdeg}"
        demand(abs(gone_cdeg) <= most_cdeg + 1, what)
        waits = edges is not None and angle_cdeg == edges[0]
        enough = gone_cdeg == way_cdeg or waits or abs(gone_cdeg) >= most_cdeg
        demand(enough, f"{servo_id} goes as far as its speed allows")
    servo.bound_cdeg = None if gone_cdeg == way_cdeg else target_cdeg
    servo.eases = servo.eases and servo.bound_cdeg is not None


@dataclass
class LandingHistory:
    """A landing: when it began and must end, for each running servo where it was and where it goes, and which part of
    its way each has been commanded: a frame may add one rate slot's part at most."""

    began_ns: int
    ends_ns: int
    ways_cdeg: Mapping[int, tuple[int, int]]
    parts_ns: dict[int, int]

    def key(self, now_ns: int) -> tuple[object, ...]:
        """Return what of it still matters."""
        parts = tuple(sorted(self.parts_ns.items()))
        return now_ns - self.began_ns, self.ends_ns - now_ns, tuple(self.ways_cdeg.items()), parts

    def judge(
        self, transmit: Transmit, servos: Mapping[int, ServoHistory], now_ns: int, rules: Rules, gap: Gap
    ) -> None:
        """Judge a frame of a landing: running servos only, each on its line, or sent its present angle again."""
        length_ns = max(rules.period_ns, rules.landing_ns - 2 * rules.period_ns)
        rounded_cdeg = 1 + -(-length_ns // NS_PER_S)  # a speed is a whole number of hundredths of a degree a second
        for servo_id, op in transmit.frame.servos:
            servo = servos[servo_id]
            if op.op is Op.STOP:
                demand(not servo.on, f"{servo_id} is stopped by its landing before it ends")
                continue
            demand(servo.on and op.op is Op.SET, f"{servo_id} is started by a landing")
            first, last = self.ways_cdeg[servo_id]
            stood_cdeg = servo.written_cdeg or 0
            part_ns = min(now_ns - self.began_ns, self.parts_ns.get(servo_id, 0) + rules.period_ns, length_ns)
            self.parts_ns[servo_id] = part_ns
            line_cdeg = first + (last - first) * part_ns // length_ns
            edges = gap(servo_id, stood_cdeg, last)
            if edges is not None and min(edges) < line_cdeg < max(edges):
                line_cdeg = edges[0]
            off_cdeg = abs(line_cdeg - op.angle_cdeg)
            crosses = gap(servo_id, stood_cdeg, line_cdeg) is not None
            if servo_id in rules.max_speed_cdeg_s and (op.angle_cdeg != stood_cdeg or crosses):
                between = sorted((stood_cdeg, line_cdeg))
                follows = between[0] - rounded_cdeg <= op.angle_cdeg <= between[1] + rounded_cdeg
                demand(follows, f"{servo_id} follows its line")
                most_cdeg = rules.max_speed_cdeg_s[servo_id] * min(now_ns - servo.said_ns, rules.period_ns) // NS_PER_S
                demand(crosses or abs(op.angle_cdeg - stood_cdeg) <= most_cdeg + 1, f"{servo_id} goes too fast")
            else:
                demand(off_cdeg <= rounded_cdeg or op.angle_cdeg == stood_cdeg, f"{servo_id} leaves its straight line")
            servo.written_cdeg, servo.said_ns, servo.bound_cdeg = op.angle_cdeg, now_ns, None
