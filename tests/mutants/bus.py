"""Mutants of gateway/robot/spi/bus.py and guard.py: what reaches the wire, and when."""

from tests.mutants.mutant import Mutant, Subject

BUS = Subject(
    "gateway/robot/spi/bus.py",
    tests=(
        "tests/unit/robot/test_bus_preamble.py",
        "tests/unit/robot/test_bus.py",
        "tests/unit/robot/test_bus_device.py",
        "tests/unit/test_setting_effects.py",
        "tests/unit/robot/test_preamble.py",
        "tests/unit/robot/test_conductor_safety.py",
    ),
    mutants=(
        Mutant(
            "LONGEST_NS: Final = 1_000_000",
            "LONGEST_NS: Final = 9_000_000",
            "a Stop waits for long calls of frames that move",
        ),
        Mutant("ZERO_PAUSE_US: Final = 100", "ZERO_PAUSE_US: Final = 1", "zeros jam a healthy controller"),
        Mutant(
            "PREAMBLE_ZEROS - self._zeros) if wanted else 0",
            "0) if wanted else 0",
            "after a fault, Stops that nobody receives",
        ),
        Mutant(
            "wanted = preamble or not self._synchronised",
            "wanted = not self._synchronised",
            "a repeated run of Stops finds a deaf controller",
        ),
        Mutant(
            "wanted = preamble or not self._synchronised",
            "wanted = preamble",
            "after a fault, Stops that nobody receives",
        ),
        Mutant(
            "            if stops and self._device is not None:\n                self._insist(data, report)\n",
            "",
            "Stops of a batch that failed wait for the device to be opened again",
        ),
        Mutant(
            "if part and self.announces and ended_ns - begun_ns > LOST_BODY_NS:",
            "if False:",
            "a body that came too late counts as received",
        ),
        Mutant(
            "        self._synchronised = False  # until it has succeeded\n",
            "",
            "after a fault, frames that nobody receives",
        ),
        Mutant(
            "                if heard:\n                    left.pop()\n",
            "                left.pop()\n",
            "a Stop that may not have been received counts as written",
        ),
        Mutant(
            "if not heard and (self._zeros or self._failures < TRIES):",
            "if not heard and self._failures < TRIES:",
            "a Stop behind a part of the zeros makes a controller deaf for longer than a preamble",
        ),
        Mutant("min(wire_ns, ended_ns)", "ended_ns", "all frames of a batch have the same time"),
        Mutant("ceil(frame_gap_us)", "int(frame_gap_us)", "the pause is shorter than what was asked for"),
        Mutant("        batch=settings.batch,\n", "", "spi.batch is ignored"),
        Mutant("        speed_hz=settings.speed_hz,\n", "", "times on the wire are those of another clock"),
        Mutant(
            "self._device, self._batch, report.rejection = device, False, str(rejection)",
            "self._batch, report.rejection = False, str(rejection)",
            "each list is tried and rejected anew",
        ),
        Mutant(
            "LOST_BODY_NS: Final = 900_000_000",
            "LOST_BODY_NS: Final = 9_000_000_000",
            "a body that came too late counts as heard",
        ),
        Mutant(
            "IDLE_NS: Final = 1_100_000_000",
            "IDLE_NS: Final = 100_000_000",
            "a controller out of sync stays deaf in a slow stream",
        ),
        Mutant("EARLY_SHARE: Final = 8", "EARLY_SHARE: Final = 1", "zeros fill every pause of a stream"),
        Mutant(
            "if self._device is not None and self._zeros < PREAMBLE_ZEROS:",
            "if self._device is not None:",
            "zeros go on for ever",
        ),
        Mutant(
            "return self._device is not None and self._zeros < PREAMBLE_ZEROS",
            "return False",
            "a pause is filled with one zero in place of sixteen",
        ),
        Mutant("return self._zeros >= PREAMBLE_ZEROS", "return self._zeros > 0", "one zero passes for a preamble"),
        Mutant(
            "        self._synchronised = self.resync_due = False\n        self._zeros = 0\n",
            "        self._zeros = 0\n",
            "after a fault the controller is taken for synchronised, and hears nothing",
            equivalent="only `open` makes it usable again, and that writes a preamble, whatever was known before",
        ),
        Mutant(
            "        self._synchronised = self.resync_due = False\n        self._zeros = 0\n",
            "        self._synchronised = self.resync_due = False\n",
            "a device opened again gets no preamble",
        ),
        Mutant("overdue = self._resync_ns > 0 and now_ns", "overdue = now_ns", "resync_ms = 0 does not switch it off"),
        Mutant("resync_ns=round(settings.resync_ms * 1e6)", "resync_ns=0", "spi.resync_ms is ignored"),
        Mutant("avoid_cdeg=settings.avoid_cdeg", "avoid_cdeg=None", "the guard ignores spi.avoid_deg"),
    ),
)

GUARD = Subject(
    "gateway/robot/spi/guard.py",
    tests=(
        "tests/unit/robot/test_guard.py",
        "tests/unit/robot/test_guard_agrees.py",
        "tests/unit/robot/test_bus_device.py",
    ),
    mutants=(
        Mutant(
            '        if announced_len is not None:\n            raise IllegalTransferError(f"the frame of',
            '        if False:\n            raise IllegalTransferError(f"the frame of',
            "an announcement without its body puts the controller out of sync",
        ),
        Mutant(
            "                if data != _ZERO:\n",
            "                if data not in (_ZERO, bytes(2)):\n",
            "two zeros in one transfer jam a healthy controller",
        ),
        Mutant(
            "    if data not in _ANNOUNCEMENTS:\n",
            "    if len(data) != 1:\n",
            "a length that overruns the controller's memory is announced",
        ),
        Mutant("    if data != canonical:\n", "    if False:\n", "a Stop with an angle passes"),
        Mutant(
            "legal = legal and not avoid_from_cdeg <= whole_deg * 100 + hundredths < avoid_to_cdeg",
            "pass",
            "an angle of which the firmware can die passes",
        ),
        Mutant(
            "frozenset((bytes((ONE_SERVO_LEN,)), bytes((ONE_LEG_LEN,))))",
            "frozenset((bytes((ONE_SERVO_LEN,)), bytes((ONE_LEG_LEN,)), bytes((65,))))",
            "a length that overruns the controller's memory is announced",
        ),
        Mutant(
            "frozenset((bytes((ONE_SERVO_LEN,)), bytes((ONE_LEG_LEN,))))",
            "frozenset((bytes((ONE_LEG_LEN,)),))",
            "no frame for a servo is written",
        ),
        Mutant(
            "self._announces = framing is Framing.LENGTH_PREFIXED",
            "self._announces = False",
            "a frame without its announcement puts the controller out of sync",
        ),
        Mutant(
            "self._announces = framing is Framing.LENGTH_PREFIXED",
            "self._announces = True",
            "a plain controller gets no frame",
        ),
        Mutant("        self._device.close()\n", "        pass\n", "the device is never released"),
        Mutant(
            "if announced_len is not None and len(data) != announced_len:",
            "if False:",
            "a body of another length than was announced passes",
        ),
        Mutant("if data[:2] == _ONE_LEG and size == ONE_LEG_LEN:", "if data[:2] == _ONE_LEG:", "half a frame passes"),
        Mutant(
            "known = ids in _IDS_OF_LEGS",
            "known = all(servo_id in SERVO_IDS for servo_id in ids)",
            "a leg's frame names servos of several legs",
        ),
        Mutant(
            "known = ids in _IDS_OF_LEGS", "known = True", "an id beyond the controller's table writes into its memory"
        ),
        Mutant(
            "and size == ONE_SERVO_LEN and data[2] in SERVO_IDS",
            "and len(data) == ONE_SERVO_LEN",
            "an id beyond the controller's table writes into its memory",
        ),
        Mutant("and size == ONE_SERVO_LEN and data[2] in SERVO_IDS", "and data[2] in SERVO_IDS", "half a frame passes"),
        Mutant(
            "    if not known:\n        return False\n",
            "",
            "an id beyond the controller's table writes into its memory",
        ),
        Mutant(
            "for index in range(3, size, 4):",
            "for index in range(3, len(data) - 4, 4):",
            "the last joint's angle is not looked at",
        ),
        Mutant(
            "for index in range(3, size, 4):",
            "for index in range(7, len(data), 4):",
            "the first joint's angle is not looked at",
        ),
        Mutant("hundredths <= 99 and", "hundredths <= 255 and", "an angle with 255 hundredths"),
        Mutant("whole_deg <= (179 if hundredths else 180)", "whole_deg <= 180", "an angle of 180.99 degrees"),
        Mutant(
            "whole_deg <= (179 if hundredths else 180)",
            "whole_deg <= 179",
            "frames to 180 degrees cost four times as much",
        ),
        Mutant(
            "legal = op == _STOP and whole_deg == hundredths == 0", "legal = op == _STOP", "a Stop with an angle passes"
        ),
        Mutant(
            "legal = op == _STOP and whole_deg == hundredths == 0",
            "legal = whole_deg == hundredths == 0",
            "an operation that nobody knows passes",
        ),
        Mutant("        if not legal:\n            return False\n", "", "an operation that nobody knows passes"),
    ),
)
