"""Mutants of gateway/robot/core/leg.py: what is kept of each leg and servo."""

from tests.mutants.mutant import Mutant, Subject

LEG = Subject(
    "gateway/robot/core/leg.py",
    tests=(
        "tests/unit/robot/test_supervisor.py",
        "tests/unit/robot/test_supervisor_stops.py",
        "tests/unit/robot/test_supervisor_faults.py",
        "tests/unit/robot/test_legs.py",
        "tests/unit/robot/test_conductor.py",
        "tests/unit/robot/test_preamble.py",
        "tests/unit/robot/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant(
            "return self.angle_cdeg is not None or (self.waiting is not None and self.waiting.op is OP_START)",
            "return self.angle_cdeg is not None or self.waiting is not None",
            "a leg that a Stop came for queues with those to be energised",
        ),
        Mutant(
            "return self.angle_cdeg is not None or (self.waiting is not None and self.waiting.op is OP_START)",
            "return self.angle_cdeg is not None",
            "a start that is pending has no watchdog, and a set after it is rejected",
        ),
        Mutant(
            "earlier = self.stopped_by if self.stopped_ns == instant_ns else frozenset[str]()",
            "earlier = frozenset[str]()",
            "of two who stopped a servo in an instant, one is forgotten: the other's older start moves it",
        ),
        Mutant(
            "earlier = self.stopped_by if self.stopped_ns == instant_ns else frozenset[str]()",
            "earlier = self.stopped_by",
            "who stopped it once keeps it from being started by another channel",
        ),
        Mutant("        self.stopped_ns = instant_ns\n", "", "an older start overtakes a Stop of its instant"),
        Mutant(
            "(third.angle_cdeg is None and third.will_run)",
            "False",
            "joint 3 is energised without a pause between two legs",
        ),
        Mutant(
            "(first.angle_cdeg is None and first.will_run)",
            "False",
            "joint 1 is energised without a pause between two legs",
        ),
        Mutant(
            "(third.angle_cdeg is None and third.will_run)",
            "third.will_run",
            "a leg that runs queues behind those to be energised",
        ),
        Mutant(
            "return first.will_run or second.will_run or third.will_run",
            "return first.will_run or second.will_run",
            "joint 3 alone has no watchdog",
        ),
        Mutant(
            "return first.will_run or second.will_run or third.will_run",
            "return first.will_run or third.will_run",
            "joint 2 alone has no watchdog",
        ),
        Mutant(
            "return first.will_run or second.will_run or third.will_run",
            "return second.will_run or third.will_run",
            "joint 1 alone has no watchdog",
        ),
        Mutant(
            "return first.will_run or second.will_run or third.will_run",
            "return first.running or second.running or third.running",
            "a start that is pending has no watchdog",
        ),
        Mutant("return self.heard_ns + timeout_ns if", "return self.heard_ns if", "each leg is stopped at once"),
        Mutant(
            "if self.heard_ns is not None and self.armed else None",
            "if self.heard_ns is not None else None",
            "the watchdog tells again and again of a leg that does nothing",
        ),
    ),
)
