"""Mutants of gateway/robot/core/{speed,landing}.py: motion that takes time."""

from tests.mutants.mutant import Mutant, Subject

SPEED = Subject(
    "gateway/robot/core/speed.py",
    tests=(
        "tests/unit/robot/test_speed.py",
        "tests/unit/robot/test_supervisor_speed.py",
        "tests/unit/robot/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant(
            "most_cdeg = speed_cdeg_s * (now_ns - since_ns) // NS_PER_S",
            "most_cdeg = -(-speed_cdeg_s * (now_ns - since_ns) // NS_PER_S)",
            "a servo whose leg gets many frames goes faster than it may",
        ),
        Mutant(
            "most_cdeg = speed_cdeg_s * (now_ns - since_ns) // NS_PER_S",
            "most_cdeg = speed_cdeg_s * now_ns // NS_PER_S",
            "a servo jumps after a pause",
        ),
        Mutant(
            "if abs(way_cdeg) <= min(most_cdeg, slot_cdeg):",
            "if way_cdeg <= min(most_cdeg, slot_cdeg):",
            "every way down is a jump",
        ),
        Mutant(
            "if abs(way_cdeg) <= min(most_cdeg, slot_cdeg):",
            "if abs(way_cdeg) < min(most_cdeg, slot_cdeg):",
            "the last step is one too many",
        ),
        Mutant(
            "if abs(way_cdeg) <= min(most_cdeg, slot_cdeg):", "if False:", "a servo swings about its target for ever"
        ),
        Mutant("return Step(to_cdeg, now_ns)", "return Step(to_cdeg, since_ns)", "the next way begins with a jump"),
        Mutant(
            "if abs(way_cdeg) <= min(most_cdeg, slot_cdeg):",
            "if abs(way_cdeg) <= most_cdeg:",
            "a servo leaps to a near target after a stall",
        ),
        Mutant("    if most_cdeg > slot_cdeg:\n", "    if False:\n", "a servo leaps after a stall"),
        Mutant(
            "-(-most_cdeg * NS_PER_S // speed_cdeg_s)",
            "most_cdeg * NS_PER_S // speed_cdeg_s",
            "a step is early by a nanosecond",
        ),
        Mutant(
            "most_cdeg if way_cdeg > 0 else -most_cdeg",
            "most_cdeg",
            "a servo goes away from its target",
        ),
        Mutant(", since_ns + used_ns)", ", since_ns)", "each step takes the time of those before it once more"),
        Mutant(", since_ns + used_ns)", ", now_ns)", "a slow servo whose leg gets many frames never moves"),
    ),
)

LANDING = Subject(
    "gateway/robot/core/landing.py",
    tests=(
        "tests/unit/robot/test_landing.py",
        "tests/unit/robot/test_supervisor_landing.py",
        "tests/unit/robot/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant("first + (last - first) * part_ns", "first - (last - first) * part_ns", "a landing stretches the legs"),
        Mutant(
            "return min(now_ns - self.began_ns, part_ns + self.period_ns,",
            "return min(now_ns - self.began_ns,",
            "a landing leaps after a stall",
        ),
        Mutant(
            "return min(now_ns - self.began_ns, part_ns", "return min(part_ns", "frames in a burst are ahead of time"
        ),
        Mutant(", self.length_ns)", ")", "a late frame goes past the pose"),
        Mutant(
            "servo.angle_cdeg is not None and servo.angle_cdeg != self.ways_cdeg[servo.servo_id][1] for servo in servos",
            "servo.angle_cdeg is not None for servo in servos",
            "legs that have arrived wake the gateway until the end",
        ),
        Mutant(
            "servo.angle_cdeg is not None and servo.angle_cdeg != self.ways_cdeg[servo.servo_id][1] for servo in servos",
            "servo.angle_cdeg is not None and servo.angle_cdeg != self.ways_cdeg[servo.servo_id][0] for servo in servos",
            "nobody wakes up to begin a landing",
        ),
        Mutant(
            "servo.angle_cdeg is not None and servo.angle_cdeg != self.ways_cdeg[servo.servo_id][1] for servo in servos",
            "servo.angle_cdeg != self.ways_cdeg[servo.servo_id][1] for servo in servos",
            "a servo that was stopped in the landing is waited for, and is in no way",
        ),
        Mutant("landing_ns - 2 * period_ns", "landing_ns", "a robot is stopped before it has arrived"),
        Mutant("landing_ns - 2 * period_ns", "ends_ns - now_ns - 2 * period_ns", "a landing that begins late leaps"),
        Mutant(
            "max(period_ns, landing_ns - 2 * period_ns)",
            "landing_ns - 2 * period_ns",
            "a landing without time divides by none, and the gateway ends in it",
        ),
    ),
)
