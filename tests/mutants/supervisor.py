"""Mutants of gateway/robot/core/supervisor.py: the rules of safety."""

from tests.mutants.mutant import Mutant, Subject

SUPERVISOR = Subject(
    "gateway/robot/core/supervisor.py",
    tests=(
        "tests/unit/robot/test_supervisor.py",
        "tests/unit/robot/test_supervisor_stops.py",
        "tests/unit/robot/test_supervisor_faults.py",
        "tests/zenoh/test_supervisor_outside.py",
        "tests/unit/robot/test_legs.py",
        "tests/unit/robot/test_lease.py",
        "tests/unit/robot/test_supervisor_landing.py",
        "tests/unit/robot/test_supervisor_calibration.py",
        "tests/unit/robot/test_conductor_safety.py",
        "tests/unit/robot/test_supervisor_machine.py",
    ),
    mutants=(
        Mutant(
            "        if self.stopped_outside:\n            return Reason.SERVO_STOPPED, _OUTSIDE\n",
            "",
            "a start is accepted, and stop-servos undoes it unseen",
        ),
        Mutant(
            "            case StoppedOutside():\n                self.stopped_outside = False\n",
            "            case StoppedOutside():\n                pass\n",
            "after stop-servos nothing can ever be started",
        ),
        Mutant(
            "effects = self._stop_all(Cause.REPEAT, now_ns, Reason.SERVO_STOPPED, _OUTSIDE)",
            "effects: list[Effect] = []",
            "what stop-servos stopped counts as running",
        ),
        Mutant(
            "        if self._ended or not self.lease.is_takeover(request):\n",
            "        if True:\n",
            "the legs run on under whoever takes the lease",
        ),
        Mutant(
            "        if self._ended or not self.lease.is_takeover(request):\n",
            "        if not self.lease.is_takeover(request):\n",
            "whoever takes the lease of a gateway that ends is told that it is granted",
        ),
        Mutant(
            "        if answer.token is not None:\n",
            "        if False:\n",
            "what others had pending moves under the new holder",
        ),
        Mutant(
            "        if self.lease.due_ns is not None:\n            self.due_ns",
            "        if self.lease.due_ns is not None and self._bus_ok:\n            self.due_ns",
            "while the bus is at fault nobody hears that the lease has expired",
        ),
        Mutant(
            "        due = self._bus_ok and self.due_ns is not None",
            "        due = self.due_ns is not None",
            "when the lease expires, frames are sent to a bus at fault",
        ),
        Mutant(
            "            self.lease.heard(command.lease, now_ns)\n",
            "            pass\n",
            "a stream without renewals loses its lease",
        ),
        Mutant(
            "        self.legs.begin(now_ns if instant_ns is None else instant_ns)\n",
            "        self.legs.instant_ns = now_ns\n",
            "where time passes in an instant, a start overtakes a Stop, and a reset an emergency stop",
        ),
        Mutant(
            "return sorted(effects, key=_after_stops)",
            "return effects",
            "a start goes out before a Stop",
        ),
        Mutant(
            "self.due_ns = self.legs.due_ns if self._bus_ok else None",
            "self.due_ns = self.legs.due_ns()",
            "the loop spins while the bus is at fault",
        ),
        Mutant(
            "        if self._ended:\n            return Mode.STOPPING\n        if not self._bus_ok:",
            "        if not self._bus_ok:",
            "a gateway that ends takes commands again",
        ),
        Mutant(
            "            return Mode.BUS_FAULT if self._opened else Mode.STARTING\n",
            "            return Mode.STARTING\n",
            "a bus at fault is shown as starting",
        ),
        Mutant(
            "        if self._latched_ns is not None:\n            return Mode.ESTOPPED\n        return Mode.IDLE",
            "        return Mode.IDLE",
            "the emergency stop does not latch",
        ),
        Mutant("if self.legs.at_rest else", "if not self.legs.at_rest else", "the state says idle while legs run"),
        Mutant("now_ns >= self.due_ns\n", "now_ns > self.due_ns\n", "woken when due, nothing happens"),
        Mutant("            effects += self.legs.repeat_stops(now_ns)\n", "", "no Stop is repeated"),
        Mutant("            effects += self.legs.take_slots(now_ns)\n", "", "what is pending is never sent"),
        Mutant(
            "        if self.mode in _REJECTING:\n            return _REJECTING[self.mode]\n        moves",
            "        moves",
            "commands are taken while the emergency stop is engaged",
        ),
        Mutant(
            "for servo_id, op in moves if self._reach.limited else ():",
            "for servo_id, op in ():",
            "joint limits are ignored",
        ),
        Mutant(
            "self.legs.landing is not None or self.calibrating.guards\n",
            "self.legs.landing is not None\n",
            "a robot starts by a calibration that could not be read",
        ),
        Mutant(
            "if type(event) is Kept and not self.calibrating.awaits(event.number):",
            "if False:",
            "the disk's answer for another change counts for this one",
        ),
        Mutant(
            "rejection = _REJECTING.get(self.mode) or self._why_closed(event.lease)",
            "rejection = _REJECTING.get(self.mode)",
            "anybody calibrates the robot that somebody drives",
        ),
        Mutant(
            "rejection = _REJECTING.get(self.mode) or self._why_closed(event.lease)",
            "rejection = self._why_closed(event.lease)",
            "a robot is calibrated whose bus is at fault",
        ),
        Mutant(
            "if event.lease is not None and self.calibrating.awaits(event.number):",
            "if False:",
            "who only calibrates loses the lease",
        ),
        Mutant(
            "if event.lease is not None and self.calibrating.awaits(event.number):",
            "if event.lease is not None:",
            "rejected changes keep the lease",
        ),
        Mutant(
            "moves = [(servo_id, op) for servo_id, op in command.targets if op.op is not OP_STOP]",
            "moves = [(servo_id, op) for servo_id, op in command.targets]",
            "a Stop is rejected, for the limits of an angle that it has not",
        ),
        Mutant(
            "moves = [(servo_id, op) for servo_id, op in command.targets if op.op is not OP_STOP]",
            "moves = [(servo_id, op) for servo_id, op in command.targets if op.op is OP_START]",
            "a set is never rejected: the controller ignores it, and everybody believes that the servo runs",
        ),
        Mutant(
            "if servo.stopped_ns == self.legs.instant_ns and not servo.stopped_by <= {command.channel}:",
            "if False:",
            "an older start overtakes a Stop of another channel",
        ),
        Mutant(
            "if servo.stopped_ns == self.legs.instant_ns and not servo.stopped_by <= {command.channel}:",
            "if servo.stopped_ns == self.legs.instant_ns:",
            "a start that follows its own channel's Stop at once is rejected",
        ),
        Mutant(
            "not servo.stopped_by <= {command.channel}:",
            "command.channel not in servo.stopped_by:",
            "who stopped a servo, too, overtakes another's Stop",
        ),
        Mutant("if op.op is OP_SET and not servo.will_run:", "if False:", "a set energises what was stopped"),
        Mutant(
            "if op.op is OP_SET and not servo.will_run:",
            "if op.op is OP_SET and not servo.running:",
            "a set after a pending start is rejected",
        ),
        Mutant("if op.op is OP_SET and not servo.will_run:", "if not servo.will_run:", "nothing can be started"),
        Mutant(
            "self._latched_ns = self.legs.instant_ns ",
            "self._latched_ns = now_ns ",
            "a reset beats an emergency stop of its instant, where time passes in it",
        ),
        Mutant(
            "        first = self._latched_ns is None\n",
            "        first = True\n",
            "an emergency stop is announced again and again",
        ),
        Mutant(
            "effects = self._stop_all(Cause.ESTOP, now_ns, Reason.ESTOPPED, _ESTOPPED)\n        if first:",
            "effects = self._stop_all(Cause.ESTOP, now_ns, Reason.ESTOPPED, _ESTOPPED) if first else []\n        if first:",
            "a second emergency stop sends nothing",
        ),
        Mutant(
            "if self.mode in _REJECTING and self.mode is not Mode.ESTOPPED:",
            "if False:",
            "a reset is accepted while the bus is at fault",
        ),
        Mutant(
            "        self.estops += 1\n",
            "        self.estops += first\n",
            "a reset that was sent before the second emergency stop leaves it",
        ),
        Mutant("        if age_ns == 0:\n", "        if False:\n", "a reset beats an emergency stop of its instant"),
        Mutant(
            "if age_ns >= self._rules.unnumbered_reset_ns:",
            "if True:",
            "a reset without a number leaves what came after it",
        ),
        Mutant(
            "if age_ns >= self._rules.unnumbered_reset_ns:",
            "if age_ns > self._rules.unnumbered_reset_ns:",
            "after just 2 s, a reset without a number is rejected",
        ),
        Mutant("if age_ns >= self._rules.unnumbered_reset_ns:", "if False:", "a reset without a number is never taken"),
        Mutant(
            "        if reset.estop < self.estops:\n",
            "        if False:\n",
            "a reset of an older emergency stop leaves the latest",
        ),
        Mutant(
            "        if reset.estop > self.estops:\n",
            "        if False:\n",
            "a reset of a number that nobody has given leaves the latest",
        ),
        Mutant(
            "        self._latched_ns = None\n        detail", "        detail", "nothing leaves the emergency stop"
        ),
        Mutant(
            "recovered, self._opened, self._bus_ok = self._opened, True, True\n        effects = self._stop_all(Cause.STARTUP, now_ns, Reason.BUS_FAULT, _BUS_FAULT)",
            "recovered, self._opened, self._bus_ok = self._opened, True, True\n        effects: list[Effect] = []",
            "after a fault, servos go on as they were",
        ),
        Mutant(
            "self._opened = self._bus_ok or not self._opened, False, True",
            "self._opened = self._bus_ok, False, True",
            "a bus that cannot be opened at the start is not told",
        ),
        Mutant(
            "effects = self.legs.drop(self.legs.servos.values(), Reason.BUS_FAULT, _BUS_FAULT)\n        if first:",
            "effects: list[Effect] = []\n        if first:",
            "what was pending before a fault is sent after it",
        ),
        Mutant("        self._ended = True\n        self", "        self", "a gateway that ends takes commands"),
        Mutant(
            "return [*self._stop_all(Cause.SHUTDOWN, now_ns, Reason.STOPPING, _STOPPING), announcement]",
            "return [announcement]",
            "the end stops nothing",
        ),
        Mutant("if now_ns >= deadline}", "if now_ns > deadline}", "woken when due, no leg is stopped"),
        Mutant(
            "        self.expirations += len(silent)\n",
            "        self.expirations += 1\n",
            "two silent legs are counted as one",
        ),
        Mutant(
            "first) for leg in self.legs} if self._rules.whole_robot else silent",
            "first) for leg in self.legs} if False else silent",
            "watchdog.scope is ignored",
        ),
        Mutant(
            "if leg.number in due and leg.armed]",
            "if leg.number in due]",
            "legs that did nothing are shown as expired",
        ),
        Mutant(
            "        for leg in expired:\n            leg.expired = True\n",
            "",
            "nobody sees which leg the watchdog has stopped",
        ),
        Mutant(
            "        if not self._bus_ok:\n            return self.legs.drop(self.legs.servos.values(), reason, detail)\n",
            "",
            "frames are written to a bus at fault",
        ),
        Mutant(
            "            return self.legs.drop(self.legs.servos.values(), reason, detail)\n        return",
            "            return []\n        return",
            "what is pending while the bus is at fault is never answered",
            equivalent="the fault itself has dropped all that was pending, and nothing is accepted until the bus is open",
        ),
        Mutant(
            "{leg.number: None for leg in self.legs}",
            "{leg.number: None for leg in self.legs if leg.runs}",
            "a leg that nobody knows to run gets no Stop",
        ),
        Mutant(
            "return not (isinstance(effect, Transmit) and effect.frame.is_stop)",
            "return not isinstance(effect, Transmit)",
            "a start goes out before a Stop",
        ),
        Mutant(
            "return not (isinstance(effect, Transmit) and effect.frame.is_stop)",
            "return isinstance(effect, Transmit)",
            "answers go out before a Stop",
        ),
        Mutant(
            "        self.legs.landing = None  # no landing goes on beside or after a Stop of all legs\n",
            "",
            "an emergency stop leaves a landing that rejects every start",
            equivalent="after its Stops all legs are at rest, and a fault of the bus ends it, too",
        ),
        Mutant(
            "        self.legs.landing = None  # the bus that opens again stops everything, and lands nothing\n",
            "",
            "after a bus fault, starts are rejected for a landing that is over",
            equivalent="the bus that opens again stops all legs, which ends it as well",
        ),
        Mutant(
            "            self.legs.landing = None  # people have stopped all that was on its way down\n",
            "            pass\n",
            "after everything was stopped in a landing, nothing can be started until it would have ended",
        ),
        Mutant(
            "return None if self.legs.landing is None else (Reason.LANDING, _LANDING)",
            "return None",
            "a laptop that is back moves its leg in the middle of a landing",
        ),
        Mutant(
            "        self.legs.landing = None\n        effects = self.legs.stop(",
            "        effects = self.legs.stop(",
            "a landing never ends",
            equivalent="after its Stops all legs are at rest, which ends it as well",
        ),
        Mutant("            effects += self.legs.land(now_ns)\n", "", "a landing holds each servo where it is"),
    ),
)


TABLE = Subject(
    "gateway/robot/core/transitions.py",
    tests=("tests/unit/robot/test_supervisor.py", "tests/unit/robot/test_supervisor_faults.py"),
    mutants=(
        Mutant(
            "        EmergencyStop: frozenset({Mode.STARTING}),\n",
            "",
            "before the bus is open, an emergency stop is an error",
        ),
    ),
)
