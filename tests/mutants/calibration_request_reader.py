"""Mutants of what comes in on keys that take `get` only, and of the calibration on its way to the disk and back."""

from tests.mutants.mutant import Mutant, Subject

TESTS = ("tests/unit/robot/test_calibration_conductor.py", "tests/unit/robot/test_calibration_intake.py")
ON_ZENOH = ("tests/zenoh/test_calibration.py", "tests/zenoh/test_lease.py")

DESKS = Subject(
    "gateway/robot/edge/request_reader.py",
    tests=ON_ZENOH,
    mutants=(
        Mutant('    if "*" in str(query.key_expr):', "    if False:", "a look at all keys is a request"),
        Mutant(
            "    if payload is not None and len(payload) > most:\n",
            "    if False:\n",
            "a large payload is read whole",
        ),
        Mutant(
            "    if query.encoding is not None and str(query.encoding) not in ENCODINGS:\n",
            "    if False:\n",
            "what is no JSON is read as JSON",
        ),
    ),
)

CALIBRATION_DESK = Subject(
    "gateway/robot/edge/calibration_request_reader.py",
    tests=(*TESTS, *ON_ZENOH),
    mutants=(
        Mutant("            return PAUSE_S\n", "            return 0.0\n", "a flood of changes delays Stops"),
        Mutant(
            "intent.source or source, reply)",
            "source, reply)",
            "nobody learns from the event who has calibrated the robot",
        ),
    ),
)

CALIBRATIONS = Subject(
    "gateway/robot/runtime/calibrations.py",
    tests=TESTS,
    mutants=(
        Mutant(
            "        if too_old is not None:\n            answers.reject(",
            "        if False:\n            answers.reject(",
            "a change that was delayed for a minute takes effect",
        ),
        Mutant(
            "            self._keep(keep.calibration, kept)\n",
            "            self._keep(keep.calibration, kept)\n            kept(None)\n",
            "a calibration counts as kept before it is on the disk",
        ),
        Mutant(
            "        effects = self._conductor.ask(Kept(number, fault))\n",
            "        effects = self._conductor.ask(Kept(number))\n",
            "what the disk did not take is in force until the next restart",
        ),
        Mutant("        self._slow.cancel()\n", "", "a disk that is well is said to hang"),
        Mutant("            self._slow.set(self._loop.time() + SLOW_S)\n", "", "nobody learns that the disk hangs"),
        Mutant("            self.tell()\n", "", "a page shows the old calibration for ever"),
        Mutant(
            "        if self._written_of is not self._in_force:",
            "        if self._written_of is None:",
            "whoever asks after a change is told the old calibration",
        ),
        Mutant(
            "intent.accept_default, source, key, intent.lease)",
            "intent.accept_default, source, key)",
            "nobody who drives can calibrate",
        ),
        Mutant(
            "Calibrate(number, intent.change, intent.revision,",
            "Calibrate(number, intent.change, None,",
            "of two who calibrate at once, one undoes what the other did",
        ),
    ),
)

CALIBRATION_INTAKE = Subject(
    "gateway/robot/core/calibration_intake.py",
    tests=TESTS,
    mutants=(
        Mutant(
            '    if payload.count(b":") > _MAX_COLONS:\n', "    if False:\n", "a payload full of mistakes delays Stops"
        ),
        Mutant("    if twice is not None:\n", "    if False:\n", "of two trims one is taken, and nobody knows which"),
        Mutant(
            "        command.accept_default is not None,\n",
            "        True,\n",
            "any change takes the default in place of a calibration that cannot be read",
        ),
        Mutant(
            "_cdeg(servo.min_deg), _cdeg(servo.max_deg)",
            "_cdeg(servo.max_deg), _cdeg(servo.min_deg)",
            "limits the wrong way round",
        ),
    ),
)
