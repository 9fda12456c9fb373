"""Mutants of gateway/robot/core/legs.py: how a leg's commands become frames, and its Stops."""

from tests.mutants.mutant import Mutant, Subject

LEGS = Subject(
    "gateway/robot/core/legs.py",
    tests=(
        "tests/unit/robot/test_supervisor.py",
        "tests/unit/robot/test_supervisor_stops.py",
        "tests/unit/robot/test_supervisor_faults.py",
        "tests/unit/robot/test_legs.py",
        "tests/unit/robot/test_supervisor_speed.py",
        "tests/unit/robot/test_supervisor_landing.py",
        "tests/unit/robot/test_supervisor_calibration.py",
        "tests/unit/robot/test_conductor.py",
        "tests/unit/robot/test_preamble.py",
        "tests/unit/robot/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant(
            "Transmit(frame if wire is None else wire.frame(frame), cause, None, numbers)",
            "Transmit(frame, cause, None, numbers)",
            "a trimmed servo goes where it would without its trim",
        ),
        Mutant(
            "            if servo.waiting is not None or servo.target_cdeg is not None:\n",
            "            if servo.waiting is not None and servo is not leg.servos[2]:\n",
            "nobody wakes up for what is pending for joint 3",
        ),
        Mutant(
            "            if servo.waiting is not None or servo.target_cdeg is not None:\n",
            "            if servo.waiting is not None and servo is not leg.servos[0]:\n",
            "nobody wakes up for what is pending for joint 1",
        ),
        Mutant(
            "else ServoOp(OP_SET, servo.angle_cdeg)",
            "else STOP",
            "a servo that nothing is pending for is stopped with its neighbour's frame",
        ),
        Mutant(
            "else ServoOp(OP_SET, servo.angle_cdeg)",
            "else ServoOp(OP_START, servo.angle_cdeg)",
            "a servo is started that nobody starts",
        ),
        Mutant(
            "            if servo.angle_cdeg is not None:\n                runs = True\n",
            "            if servo.angle_cdeg:\n                runs = True\n",
            "the state says idle while a servo runs at 0 degrees",
        ),
        Mutant("if len(servos) == len(leg.servos):", "if servos:", "a Stop for one servo stops its whole leg"),
        Mutant("if len(servos) == len(leg.servos):", "if False:", "a leg's three Stops take three times as long"),
        Mutant(
            "due_ns = NEVER if deadline_ns is None else deadline_ns",
            "due_ns = NEVER",
            "nobody wakes up for the watchdog",
        ),
        Mutant(
            "            if servo.repeats_left and servo.repeat_ns < repeat_ns:\n",
            "            if False:\n",
            "nobody wakes up to repeat a Stop",
        ),
        Mutant(
            "            if slot_ns is not None and slot_ns < due_ns:\n",
            "            if False:\n",
            "nobody wakes up for a rate slot",
        ),
        Mutant(
            "self.repeat_ns = None if repeat_ns == NEVER else repeat_ns",
            "self.repeat_ns = None",
            "no pause is filled with the preamble for repeated Stops",
        ),
        Mutant(
            "due_ns = leg.due_ns if leg.due_ns < due_ns else due_ns",
            "due_ns = leg.due_ns if leg.due_ns != NEVER else due_ns",
            "it wakes up for what the last leg has due",
        ),
        Mutant(
            "due_ns if due_ns < repeat_ns else repeat_ns, repeat_ns",
            "repeat_ns if due_ns < repeat_ns else due_ns, repeat_ns",
            "it wakes up for the last thing that a leg has due",
        ),
        Mutant(
            "repeat_ns = leg.repeat_ns if leg.repeat_ns < repeat_ns else repeat_ns",
            "repeat_ns = leg.repeat_ns",
            "only the sixth leg's repeats have their preamble in a pause",
        ),
        Mutant(
            "at_rest = at_rest and not leg.runs", "at_rest = not leg.runs", "with leg 1 alone running, it says idle"
        ),
        Mutant(
            "        self._moved = None\n        return [effect",
            "        return [effect",
            "a leg whose repeat or rate slot came with another's command is forgotten",
        ),
        Mutant(
            "        elif not self._rules.start_pause_ns:  #",
            "        else:  #",
            "a leg behind another in the queue of starts is forgotten, or woken for nothing",
        ),
        Mutant(
            "                moved.append(leg)\n",
            "",
            "a command to one leg arms no watchdog",
        ),
        Mutant(
            "            self._look_at(leg)\n        self._moved = None\n",
            "            self._look_at(leg)\n",
            "after a command to one leg, another's Stop is forgotten",
        ),
        Mutant(
            "        self.stops = True\n        servo.angle_cdeg = servo.target_cdeg = None\n",
            "        servo.angle_cdeg = servo.target_cdeg = None\n",
            "a start goes out before a Stop",
        ),
        Mutant(
            "            self.stops = True\n            servo.repeats_left -= 1\n",
            "            servo.repeats_left -= 1\n",
            "a frame that moves goes out before a repeated Stop",
        ),
        Mutant(
            "        for servo in servos:\n            effects += self._replaced(servo)\n            servo.note_stop(command",
            "        for servo in servos:\n            servo.note_stop(command",
            "an older start comes after the Stop",
        ),
        Mutant(
            "            servo.note_stop(command.channel, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
            "            self._stopped(servo, now_ns)\n",
            "an older start of the same instant overtakes the Stop",
        ),
        Mutant(
            "            servo.note_stop(command.channel, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
            "            servo.note_stop(command.channel, now_ns)\n            self._stopped(servo, now_ns)\n",
            "an older start of the same instant overtakes the Stop, where time passes in it",
        ),
        Mutant(
            "            servo.note_stop(command.channel, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
            "            servo.note_stop(command.channel, self.instant_ns)\n",
            "a servo that was stopped on command counts as running",
        ),
        Mutant(
            "leg.expired = leg.expired and len(servos) < len(leg.servos)",
            "leg.expired = False",
            "a Stop for one servo hides that the watchdog has stopped its leg",
        ),
        Mutant(
            "leg.expired = leg.expired and len(servos) < len(leg.servos)",
            "pass",
            "a leg that was stopped on command is shown as expired",
        ),
        Mutant(
            "return effects + self._empty_start_queue(command.number)",
            "return effects",
            "whoever stops one leg sees another start a moment later",
        ),
        Mutant(
            "return effects + self._empty_start_queue(command.number)",
            "return effects + self._empty_start_queue()",
            "a command that stops one leg and starts another rejects itself",
        ),
        Mutant(
            "newest = merged(servo.waiting, op)",
            "newest = op",
            "a pending start becomes a set",
        ),
        Mutant(
            "            if op.op is OP_STOP:\n                servo.note_stop(command.channel, self.instant_ns)\n",
            "",
            "an older start overtakes a Stop that came with moves",
        ),
        Mutant(
            "            if op.op is OP_STOP:\n                servo.note_stop(command.channel, self.instant_ns)\n",
            "            if op.op is OP_STOP:\n                servo.note_stop(command.channel, now_ns)\n",
            "an older start overtakes a Stop that came with moves, where time passes in an instant",
        ),
        Mutant(
            "if servo.waiting is not None and servo.waiting.op is OP_STOP:\n                servo.waiting = None\n",
            "if False:\n                servo.waiting = None\n",
            "a Stop that came with moves waits for the rate slot",
        ),
        Mutant(
            "if servo.running or not servo.repeats_left:",
            "if servo.running:",
            "a Stop for a servo that nobody knows to run is not sent",
        ),
        Mutant(
            "if servo.running or not servo.repeats_left:",
            "if not servo.repeats_left:",
            "a Stop that came with moves, shortly after another, is not sent",
            equivalent="a servo that runs has no repeats left: whatever energises it takes them",
        ),
        Mutant(
            "if servo.running or not servo.repeats_left:",
            "if True:",
            "a stream above the rate that keeps a servo stopped fills the bus",
        ),
        Mutant(
            "            self._queue.join(leg.number)\n", "            pass\n", "a leg to be energised is in no queue"
        ),
        Mutant(
            "            self._queue.join(leg.number)\n        elif self._queue.legs:\n            self._queue.leave(leg.number)\n",
            "            self._queue.join(leg.number)\n",
            "a leg that need not be energised any more keeps others off",
        ),
        Mutant(
            "if not (waiting or (limited and leg.is_bound)) or not leg.slots.is_open(now_ns):",
            "if not (waiting or (limited and leg.is_bound)):",
            "no rate limit",
        ),
        Mutant(
            "            if not self._queue.admits(leg.number, now_ns):\n                return []\n",
            "",
            "all legs are energised at once: the supply breaks down",
        ),
        Mutant("            self._queue.started(leg.number, now_ns)\n", "", "no pause between two legs"),
        Mutant("        leg.slots.take(now_ns)\n", "", "no rate limit"),
        Mutant(
            "waiting[0][1]) if len(waiting) == 1 else",
            "waiting[0][1]) if waiting else",
            "of three targets one is sent",
        ),
        Mutant(
            "            servo.waiting = None\n            if target.op is OP_STOP:\n                self._stopped(servo, now_ns)\n",
            "            servo.waiting = None\n            if target.op is OP_STOP:\n                servo.angle_cdeg = None\n",
            "a Stop that came with moves is not repeated",
        ),
        Mutant(
            "                servo.angle_cdeg = target.angle_cdeg\n                servo.repeats_left = 0",
            "                servo.angle_cdeg = target.angle_cdeg\n                servo.repeats_left += 0",
            "a repeated Stop undoes the start that came after it",
        ),
        Mutant(
            "                leg.expired = False\n            if servo.waiting",
            "            if servo.waiting",
            "a leg that runs again is shown as expired",
        ),
        Mutant(
            "            servo.note_stop(cause, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
            "            self._stopped(servo, now_ns)\n",
            "a start of the same instant undoes the watchdog's Stop",
        ),
        Mutant(
            "            servo.note_stop(cause, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
            "            servo.note_stop(cause, now_ns)\n            self._stopped(servo, now_ns)\n",
            "a start of the same instant undoes the watchdog's Stop, where time passes in it",
        ),
        Mutant(
            "            servo.note_stop(cause, self.instant_ns)\n            self._stopped(servo, now_ns)\n",
            "            servo.note_stop(cause, self.instant_ns)\n",
            "what the gateway stops counts as running",
        ),
        Mutant(
            "return [*transmits, *self.drop(servos, reason, detail), *self._empty_start_queue()]",
            "return [*transmits, *self._empty_start_queue()]",
            "a pending start comes after the watchdog's Stop",
        ),
        Mutant(
            "return [*transmits, *self.drop(servos, reason, detail), *self._empty_start_queue()]",
            "return [*transmits, *self.drop(servos, reason, detail)]",
            "after a watchdog's Stop another leg starts a moment later",
        ),
        Mutant(
            "transmits = [Transmit(stop_leg(number), cause, deadline)",
            "transmits = [Transmit(stop_leg(number), cause)",
            "how late a Stop was is not measured",
        ),
        Mutant(
            "        servo.angle_cdeg = servo.target_cdeg = None\n        servo.repeats_left",
            "        servo.repeats_left",
            "a stopped servo counts as running: a set moves nothing and is accepted",
        ),
        Mutant("servo.repeats_left = self._rules.repeats\n", "servo.repeats_left = 1\n", "watchdog.repeats is ignored"),
        Mutant(
            "        servo.repeat_ns = now_ns + self._rules.repeat_interval_ns\n\n    def _empty_start_queue",
            "        servo.repeat_ns = now_ns\n\n    def _empty_start_queue",
            "the first repeat comes at once",
        ),
        Mutant(
            "if servo.waiting is not None and servo.waiting_number != own]",
            "if servo.waiting is not None]",
            "a command that stops one leg and starts another rejects itself",
        ),
        Mutant(
            "        self._pending[servo.waiting_number].coalesced = True\n",
            "",
            "nobody is told that a target was replaced",
        ),
        Mutant(
            "        pending.targets -= 1\n        return",
            "        pending.targets -= 2\n        return",
            "a command is acknowledged too early",
        ),
        Mutant(
            "                pending.targets -= 1\n",
            "                pending.targets -= 2\n",
            "a command is never acknowledged",
        ),
        Mutant(
            "                if not pending.targets:\n",
            "                if True:\n",
            "a command is acknowledged too early",
        ),
        Mutant(
            "        for servo in self.servos.values():  # what is rejected here must not take effect on another leg\n",
            "        for servo in servos:  # what is rejected here must not take effect on another leg\n",
            "what was rejected for one leg still moves another",
        ),
        Mutant(
            "            if not leg.waits_to_start:\n                self._queue.leave(leg.number)\n",
            "            pass\n",
            "a leg whose start was dropped keeps the others off",
        ),
        Mutant(
            "if servo.repeats_left and now_ns >= servo.repeat_ns]",
            "if servo.repeats_left]",
            "repeats come at every step, not in their time",
        ),
        Mutant(
            "if servo.repeats_left and now_ns >= servo.repeat_ns]",
            "if servo.repeats_left and now_ns > servo.repeat_ns]",
            "woken when due, no Stop is repeated",
        ),
        Mutant("            servo.repeats_left -= 1\n", "", "a Stop is repeated for ever"),
        Mutant(
            "            servo.repeats_left -= 1\n            servo.repeat_ns = now_ns + self._rules.repeat_interval_ns\n",
            "            servo.repeats_left -= 1\n            servo.repeat_ns += self._rules.repeat_interval_ns\n",
            "late repeats are made up in a burst",
        ),
        Mutant(
            "            if servo.waiting is not None or servo.target_cdeg is not None:\n",
            "            if servo.waiting is not None:\n",
            "a servo whose speed is limited stops on its way to the target",
        ),
        Mutant(
            "servo.angle_cdeg = servo.target_cdeg = None",
            "servo.angle_cdeg = None",
            "a stopped servo goes on to its target",
        ),
        Mutant(
            "servo.waiting, servo.waiting_number, servo.target_cdeg = newest, command.number, None",
            "servo.waiting, servo.waiting_number = newest, command.number",
            "a servo goes on to an older target",
            equivalent="the frame that says the newer target forgets the older one, and there is none between the two",
        ),
        Mutant(
            "            servo.target_cdeg = None  # nor does it go on to where an earlier command sent it\n",
            "            pass\n",
            "under a new holder of the lease, servos go on to where the one before sent them",
        ),
        Mutant(
            "                    servo.since_ns = now_ns  # the frame tells",
            "                    pass  # the frame tells",
            "after its leg's other servos have moved, a servo takes a step of twice its speed",
        ),
        Mutant(
            "            due_ns = self.landing.ends_ns\n",
            "            pass\n",
            "nobody wakes up for the end of a landing",
        ),
        Mutant(
            "due_ns = min(due_ns, max(self.land_ns, leg.slots.next_ns))",
            "pass",
            "a landing holds each servo where it is",
        ),
        Mutant(
            "        if self.landing is None or now_ns < self.land_ns:\n",
            "        if self.landing is None:\n",
            "a landing fills the bus with frames",
        ),
    ),
)
