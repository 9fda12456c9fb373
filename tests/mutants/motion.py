"""Mutants of gateway/core/{speed,landing}.py: motion that takes time."""

from tests.mutants.mutant import Mutant, Subject

SPEED = Subject(
    "gateway/core/speed.py",
    tests=(
        "tests/unit/test_speed.py",
        "tests/unit/test_supervisor_speed.py",
        "tests/unit/test_supervisor_machine.py",
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
        Mutant("if abs(way_cdeg) <= most_cdeg:", "if way_cdeg <= most_cdeg:", "every way down is a jump"),
        Mutant("if abs(way_cdeg) <= most_cdeg:", "if abs(way_cdeg) < most_cdeg:", "the last step is one too many"),
        Mutant("if abs(way_cdeg) <= most_cdeg:", "if False:", "a servo swings about its target for ever"),
        Mutant("return Step(to_cdeg, now_ns)", "return Step(to_cdeg, since_ns)", "the next way begins with a jump"),
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
    "gateway/core/landing.py",
    tests=(
        "tests/unit/test_landing.py",
        "tests/unit/test_supervisor_landing.py",
        "tests/unit/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant("        if now_ns >= self.arrives_ns:\n", "        if False:\n", "a late frame goes past the pose"),
        Mutant(
            "        if now_ns >= self.arrives_ns:\n",
            "        if now_ns > self.arrives_ns:\n",
            "a landing without time divides by none, and the gateway ends in it",
        ),
        Mutant(
            "            return last\n", "            return first\n", "the robot springs back up before it is stopped"
        ),
        Mutant(
            "first + (last - first) * (now_ns - self.began_ns)",
            "first - (last - first) * (now_ns - self.began_ns)",
            "a landing stretches the legs",
        ),
        Mutant("* (now_ns - self.began_ns) //", "* now_ns //", "a landing begins with a jump"),
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
        Mutant("ends_ns - 2 * period_ns", "ends_ns", "a robot is stopped before it has arrived"),
        Mutant(
            "max(now_ns, ends_ns - 2 * period_ns)",
            "ends_ns - 2 * period_ns",
            "a short landing runs backwards",
            equivalent="a time that has passed has passed: it is compared with now, and nothing else",
        ),
    ),
)
