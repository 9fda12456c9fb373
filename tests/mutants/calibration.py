"""Mutants of gateway/robot/core/{calibration,calibrating,reach}.py: what users mean, what the wire carries, and its change."""

from tests.mutants.mutant import Mutant, Subject

_TESTS = (
    "tests/unit/robot/test_calibration.py",
    "tests/unit/robot/test_supervisor_calibration.py",
    "tests/unit/robot/test_supervisor_calibration_streams.py",
    "tests/unit/robot/test_supervisor.py",
    "tests/unit/robot/test_supervisor_landing.py",
    "tests/unit/robot/test_supervisor_machine.py",
)

REACH = Subject(
    "gateway/robot/core/joint_limits.py",
    tests=_TESTS,
    mutants=(
        Mutant(
            "if limits is not None and not limits[0] <= angle_cdeg <= limits[1]:",
            "if False:",
            "joint limits are ignored",
        ),
        Mutant(
            "limits[0] <= angle_cdeg <= limits[1]:",
            "limits[0] < angle_cdeg <= limits[1]:",
            "the least angle itself is rejected",
        ),
        Mutant(
            "limits[0] <= angle_cdeg <= limits[1]:",
            "limits[0] <= angle_cdeg < limits[1]:",
            "the largest angle itself is rejected",
        ),
        Mutant("limits[0] <= angle_cdeg <= limits[1]:", "limits[0] <= angle_cdeg:", "the largest angle is ignored"),
        Mutant(
            "return calibration.why_not(servo_id, angle_cdeg) or ",
            "return ",
            "an angle that the servo does not have ends the gateway",
        ),
        Mutant(
            "self.wire = calibration if calibration.servos else None",
            "self.wire = None",
            "a trimmed servo goes where it would without its trim",
        ),
        Mutant(
            "bool(self._limits_cdeg or calibration.servos or self._avoid_cdeg)",
            "bool(self._limits_cdeg or self._avoid_cdeg)",
            "calibrated limits are ignored where the settings have none",
        ),
        Mutant(
            "bool(self._limits_cdeg or calibration.servos or self._avoid_cdeg)",
            "bool(calibration.servos or self._avoid_cdeg)",
            "the settings' limits are ignored where nothing is calibrated",
        ),
        Mutant(
            "{**self._landing_cdeg, **self.calibration.landing_cdeg}",
            "{**self.calibration.landing_cdeg, **self._landing_cdeg}",
            "the pose that a person recorded on the robot gives way to the file's",
        ),
        Mutant(
            "{**self._landing_cdeg, **self.calibration.landing_cdeg}",
            "self.calibration.landing_cdeg",
            "the settings' pose is ignored",
        ),
        Mutant(
            "for servo_id, angle in pose.items() if self.why_not(servo_id, angle) is None}",
            "for servo_id, angle in pose.items()}",
            "a landing drives a servo beyond its limits",
        ),
    ),
)

CALIBRATING = Subject(
    "gateway/robot/core/calibrating.py",
    tests=_TESTS,
    mutants=(
        Mutant("        self.guards = fault is not None\n", "", "a robot starts by a calibration that was not read"),
        Mutant("        self.fault = fault\n", "", "a robot starts by a calibration that was not read"),
        Mutant(
            "        self._reach.use(calibration)\n        self.fault = fault\n",
            "        self.fault = fault\n",
            "what was kept is forgotten at each start",
        ),
        Mutant(
            "self._on_its_way is not None and self._on_its_way.event.number == number",
            "self._on_its_way is not None",
            "the disk's answer for another change counts for this one",
        ),
        Mutant(
            "            if servo_id in changing:\n",
            "            if False:\n",
            "a servo starts by the old calibration, and jumps once the new one is in force",
        ),
        Mutant(
            "            if servo_id in changing:\n",
            "            if changing:\n",
            "while one servo is calibrated, none can be started",
        ),
        Mutant(
            "            if servos[servo_id].will_run:\n",
            "            if servos[servo_id].running:\n",
            "a start that waits for its rate slot is sent by another calibration than it was checked by",
        ),
        Mutant(
            "            if servos[servo_id].will_run:\n",
            "            if False:\n",
            "a running servo jumps by the trim that it gets",
        ),
        Mutant(
            "        self.guards = True\n        return [Keep",
            "        return [Keep",
            "a servo starts by the old calibration, and jumps once the new one is in force",
        ),
        Mutant(
            "before = Calibration(self.in_force.revision) if event.accept_default else self.in_force",
            "before = self.in_force",
            "what was loaded in part is taken for the default that somebody accepted",
        ),
        Mutant(
            "Calibration(self.in_force.revision) if",
            "Calibration() if",
            "revisions are used twice",
        ),
        Mutant(
            "        if self._on_its_way is not None:\n            hint",
            "        if False:\n            hint",
            "of two changes in one instant, the first is kept but never answered",
        ),
        Mutant(
            "if event.revision not in (None, revision):",
            "if False:",
            "of two people who calibrate, one undoes the other's work unseen",
        ),
        Mutant(
            "if event.revision not in (None, revision):",
            "if event.revision != revision:",
            "a change that names no revision is rejected",
        ),
        Mutant(
            "if self.fault is not None and not event.accept_default:",
            "if False:",
            "a changed trim makes an unread calibration a good one",
        ),
        Mutant(
            "if self.fault is not None and not event.accept_default:",
            "if self.fault is not None:",
            "a robot whose file is broken never moves again",
        ),
        Mutant(
            "if self.fault is None and event.accept_default:",
            "if False:",
            "a robot's good calibration is wiped by accepting the default",
        ),
        Mutant(
            '        self._on_its_way, self._delay = None, ""\n',
            '        self._delay = ""\n',
            "only one change can be made in the gateway's life",
        ),
        Mutant(
            "            self._reach.use(calibration)\n            self.fault = None\n",
            "            self.fault = None\n",
            "a new calibration is in force after the next start only",
        ),
        Mutant(
            "            self._reach.use(calibration)\n            self.fault = None\n",
            "            self._reach.use(calibration)\n",
            "after the default was accepted, still nothing starts",
        ),
        Mutant(
            "        if event.fault is None:\n            self._reach",
            "        if True:\n            self._reach",
            "a calibration is in force that the disk does not have",
        ),
        Mutant(
            "        self.guards = self.fault is not None\n        if event",
            "        self.guards = False\n        if event",
            "a full disk makes an unread calibration a good one",
        ),
        Mutant(
            "        self.guards = self.fault is not None\n        if event",
            "        if event",
            "every command is checked once more than it needs, for ever",
            equivalent="what is checked finds nothing; it costs calls only",
        ),
        Mutant(
            "            return [Rejected(event.number, Reason.INVALID, event.fault)]\n",
            "            return [Completed(event.number)]\n",
            "somebody believes a calibration to be kept that is not",
        ),
        Mutant(
            ", Completed(event.number)]",
            "]",
            "who calibrates is never answered",
        ),
        Mutant(
            "Announce(Kind.CALIBRATED, detail, asked.source, asked.key)",
            "Announce(Kind.CALIBRATED, detail)",
            "nobody knows who changed the calibration",
        ),
    ),
)

CALIBRATION = Subject(
    "gateway/robot/core/calibration.py",
    tests=("tests/unit/robot/test_calibration.py", "tests/unit/robot/test_supervisor_calibration.py"),
    mutants=(
        Mutant(
            "return (MAX_ANGLE_CDEG - user_cdeg if self.inverted else user_cdeg) + self.trim_cdeg",
            "return MAX_ANGLE_CDEG - user_cdeg - self.trim_cdeg if self.inverted else user_cdeg + self.trim_cdeg",
            "the trim of an inverted servo goes the wrong way",
        ),
        Mutant(
            "return (MAX_ANGLE_CDEG - user_cdeg if self.inverted else user_cdeg) + self.trim_cdeg",
            "return user_cdeg + self.trim_cdeg",
            "no servo is inverted",
        ),
        Mutant(
            "return (MAX_ANGLE_CDEG - user_cdeg if self.inverted else user_cdeg) + self.trim_cdeg",
            "return MAX_ANGLE_CDEG - user_cdeg if self.inverted else user_cdeg",
            "no servo is trimmed",
        ),
        Mutant(
            "untrimmed = wire_cdeg - self.trim_cdeg",
            "untrimmed = wire_cdeg + self.trim_cdeg",
            "what was sent is shown off by twice the trim",
        ),
        Mutant(
            "return MAX_ANGLE_CDEG - untrimmed if self.inverted else untrimmed",
            "return untrimmed",
            "what was sent to an inverted servo is shown the wrong way round",
        ),
        Mutant(
            "            _check(servo_id, servo)\n",
            "            pass\n",
            "limits the wrong way round are kept, and nothing can be commanded",
        ),
        Mutant(
            "            if servo_id not in SERVO_IDS:\n",
            "            if False:\n",
            "a servo that does not exist is kept in the file",
        ),
        Mutant(
            "            if why_not is not None:\n                raise",
            "            if False:\n                raise",
            "a landing pose that cannot be reached is kept",
        ),
        Mutant(
            "if servo != AS_DRAWN}",
            "}",
            "a servo that is calibrated as drawn costs each frame",
        ),
        Mutant(
            "if not servo.min_cdeg <= user_cdeg <= servo.max_cdeg:",
            "if False:",
            "a knee hits the body beyond its limit",
        ),
        Mutant(
            "if not servo.min_cdeg <= user_cdeg <= servo.max_cdeg:",
            "if not servo.min_cdeg <= user_cdeg < servo.max_cdeg:",
            "the largest angle itself is rejected",
        ),
        Mutant(
            "if not servo.min_cdeg <= user_cdeg <= servo.max_cdeg:",
            "if not servo.min_cdeg < user_cdeg <= servo.max_cdeg:",
            "the least angle itself is rejected",
        ),
        Mutant(
            "if not 0 <= wire_cdeg <= MAX_ANGLE_CDEG:",
            "if False:",
            "an angle that the servo does not have ends the gateway",
        ),
        Mutant(
            "if not 0 <= wire_cdeg <= MAX_ANGLE_CDEG:",
            "if not 0 < wire_cdeg <= MAX_ANGLE_CDEG:",
            "the servo's own 0 is out of reach",
        ),
        Mutant(
            "if not 0 <= wire_cdeg <= MAX_ANGLE_CDEG:",
            "if not 0 <= wire_cdeg < MAX_ANGLE_CDEG:",
            "the servo's own 180 is out of reach",
        ),
        Mutant(
            "if servo is None or op.op is OP_STOP:",
            "if servo is None:",
            "a Stop for a trimmed servo becomes something else",
        ),
        Mutant(
            "return ServoOp(op.op, servo.wire_cdeg(op.angle_cdeg))",
            "return ServoOp(op.op, servo.user_cdeg(op.angle_cdeg))",
            "trims go the wrong way",
        ),
        Mutant(
            "return ServoOp(op.op, servo.wire_cdeg(op.angle_cdeg))",
            "return ServoOp(OP_SET, servo.wire_cdeg(op.angle_cdeg))",
            "a trimmed servo never starts",
        ),
        Mutant(
            "return OneServo(frame.servo_id, self._wire_op(frame.servo_id, frame.command))",
            "return frame",
            "a servo that is commanded alone is not trimmed",
        ),
        Mutant(
            "        first, second, third = (self._wire_op(servo_id, op) for servo_id, op in frame.servos)\n",
            "        first, third, second = (self._wire_op(servo_id, op) for servo_id, op in frame.servos)\n",
            "two joints get each other's angles",
        ),
        Mutant(
            "if value is not None}",
            "if value}",
            "a trim cannot be taken back, nor a direction",
        ),
        Mutant(
            "before.of(servo_id)._replace(**named)",
            "AS_DRAWN._replace(**named)",
            "who changes a limit loses the trim",
        ),
        Mutant(
            "        servos = dict(before.servos)\n",
            "        servos = dict[int, ServoCalibration]()\n",
            "who changes one servo loses all others",
        ),
        Mutant(
            "landing = {**before.landing_cdeg, **self.landing_cdeg}",
            "landing = dict(self.landing_cdeg)",
            "who changes one landing angle loses all others",
        ),
        Mutant(
            "for servo_id, angle in landing.items() if angle is not None}",
            "for servo_id, angle in landing.items()}",
            "a servo cannot be taken out of the landing pose",
        ),
        Mutant(
            "revision=before.revision + 1,",
            "revision=before.revision,",
            "of two people who calibrate, one undoes the other's work unseen",
        ),
        Mutant(
            "if before.of(servo_id) != after.of(servo_id))",
            "if before.of(servo_id).trim_cdeg != after.of(servo_id).trim_cdeg)",
            "a running servo jumps to the other side when its direction changes",
        ),
        Mutant(
            "if abs(servo.trim_cdeg) > MAX_TRIM_CDEG:",
            "if servo.trim_cdeg > MAX_TRIM_CDEG:",
            "a trim of -400 is kept",
        ),
        Mutant(
            "if abs(servo.trim_cdeg) > MAX_TRIM_CDEG:",
            "if abs(servo.trim_cdeg) >= MAX_TRIM_CDEG:",
            "a horn a quarter of a turn off cannot be trimmed",
        ),
        Mutant(
            "        if not 0 <= angle_cdeg <= MAX_ANGLE_CDEG:\n",
            "        if False:\n",
            "limits that no angle has are kept",
        ),
        Mutant(
            "    if servo.min_cdeg > servo.max_cdeg:\n",
            "    if servo.min_cdeg >= servo.max_cdeg:\n",
            "a servo cannot be held to one angle",
        ),
        Mutant(
            "    if servo.min_cdeg > servo.max_cdeg:\n",
            "    if False:\n",
            "limits the wrong way round are kept, and nothing can be commanded",
        ),
    ),
)
