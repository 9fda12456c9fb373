"""Mutants of gateway/robot/core/pacing.py: rate slots, merging, and the queue of starts."""

from tests.mutants.mutant import Mutant, Subject

PACING = Subject(
    "gateway/robot/core/pacing.py",
    tests=(
        "tests/unit/robot/test_pacing.py",
        "tests/unit/robot/test_supervisor.py",
        "tests/unit/robot/test_supervisor_faults.py",
        "tests/unit/robot/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant("BUCKET: Final = 3\n", "BUCKET: Final = 2\n", "a stream at the limit waits for its own jitter"),
        Mutant("BUCKET: Final = 3\n", "BUCKET: Final = 4\n", "more than the rate and three in a second"),
        Mutant("SPACING_SHARE: Final = 4\n", "SPACING_SHARE: Final = 5\n", "frames closer than a quarter of a period"),
        Mutant("SPACING_SHARE: Final = 4\n", "SPACING_SHARE: Final = 2\n", "a jittering stream waits twice as long"),
        Mutant(
            "if older.op is OP_START and newer.op is OP_SET:",
            "if older.op is OP_START:",
            "a Stop or start after a pending start is sent as a start of angle 0",
        ),
        Mutant(
            "if older.op is OP_START and newer.op is OP_SET:",
            "if newer.op is OP_SET:",
            "a set energises a servo that nobody started",
        ),
        Mutant(
            "if older.op is OP_START and newer.op is OP_SET:",
            "if False:",
            "a pending start becomes a set, and the servo stays off",
        ),
        Mutant("ServoOp(OP_START, newer.angle_cdeg)", "older", "the older angle is sent"),
        Mutant("    return newer\n", "    return older\n", "the oldest target counts"),
        Mutant(
            "oldest_ns: int = -BUCKET * NS_PER_S",
            "oldest_ns: int = 0",
            "soon after boot, the bucket is not full before the first frame",
        ),
        Mutant("return now_ns >= self.next_ns\n", "return now_ns > self.next_ns\n", "woken when due, nothing is sent"),
        Mutant("return now_ns >= self.next_ns\n", "return True\n", "no rate limit"),
        Mutant(
            "(self.oldest_ns if self.oldest_ns > kept_ns else kept_ns) + self.period_ns",
            "self.oldest_ns + self.period_ns",
            "every missed slot is made up: a flood after a silence is not limited at all",
        ),
        Mutant(
            "(self.oldest_ns if self.oldest_ns > kept_ns else kept_ns) + self.period_ns",
            "now_ns + self.period_ns",
            "no bucket: a stream at the limit waits for its own jitter, for good",
        ),
        Mutant("(BUCKET - 1) * self.period_ns", "BUCKET * self.period_ns", "four slots are kept"),
        Mutant("(BUCKET - 1) * self.period_ns", "(BUCKET - 2) * self.period_ns", "two slots are kept"),
        Mutant("self.oldest_ns if self.oldest_ns > soonest_ns else soonest_ns", "self.oldest_ns", "a burst"),
        Mutant(
            "self.oldest_ns if self.oldest_ns > soonest_ns else soonest_ns",
            "soonest_ns",
            "four times the rate",
        ),
        Mutant("- (-self.period_ns // SPACING_SHARE)", "+ self.period_ns // SPACING_SHARE", "a nanosecond too close"),
        Mutant("if self.pause_ns and leg not in self.legs:", "if self.pause_ns:", "a leg is in the queue twice"),
        Mutant("if self.pause_ns and leg not in self.legs:", "if leg not in self.legs:", "legs pile up in no queue"),
        Mutant(
            "self.legs.append(leg)", "self.legs.insert(0, leg)", "the last comes first: the others may wait for ever"
        ),
        Mutant("self.legs[0] == leg and now_ns >= self.next_ns", "now_ns >= self.next_ns", "no order among the legs"),
        Mutant(
            "self.legs[0] == leg and now_ns >= self.next_ns", "self.legs[0] == leg", "no pause: the supply breaks down"
        ),
        Mutant(
            "self.legs[0] == leg and now_ns >= self.next_ns",
            "self.legs[0] == leg and now_ns > self.next_ns",
            "woken when due, no leg is energised",
        ),
        Mutant(
            "        self.leave(leg)\n        self.next_ns",
            "        self.next_ns",
            "a leg that runs keeps the others off",
        ),
        Mutant("self.next_ns = now_ns + self.pause_ns", "self.next_ns = now_ns", "no pause: the supply breaks down"),
        Mutant(
            "            self.legs.remove(leg)", "            self.legs.clear()", "who waited behind it loses its place"
        ),
        Mutant(
            "            return slot_ns\n", "            return None\n", "a set that is pending is sent late or never"
        ),
        Mutant(
            "return max(slot_ns, self.next_ns) if self.legs[0] == leg else None",
            "return slot_ns if self.legs[0] == leg else None",
            "the loop spins until the pause is over",
        ),
        Mutant(
            "return max(slot_ns, self.next_ns) if self.legs[0] == leg else None",
            "return self.next_ns if self.legs[0] == leg else None",
            "the loop spins until the slot comes",
        ),
        Mutant(
            "return max(slot_ns, self.next_ns) if self.legs[0] == leg else None",
            "return max(slot_ns, self.next_ns)",
            "the loop spins for a leg that others are before",
        ),
    ),
)
