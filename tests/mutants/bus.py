"""Mutants of gateway/spi/bus.py and guard.py: what reaches the wire, and when."""

from tests.mutants.mutant import Mutant, Subject

BUS = Subject(
    "gateway/spi/bus.py",
    tests=(
        "tests/unit/test_bus_preamble.py",
        "tests/unit/test_bus.py",
        "tests/unit/test_bus_device.py",
        "tests/unit/test_setting_effects.py",
        "tests/unit/test_preamble.py",
        "tests/unit/test_conductor_safety.py",
    ),
    mutants=(
        Mutant(
            "STALE_ANNOUNCEMENT_NS: Final = 500_000_000",
            "STALE_ANNOUNCEMENT_NS: Final = 400_000_000",
            "a frame that would be heard is written twice",
        ),
        Mutant(
            "STALE_ANNOUNCEMENT_NS: Final = 500_000_000",
            "STALE_ANNOUNCEMENT_NS: Final = 1_500_000_000",
            "a body that nobody awaits puts the controller out of sync",
        ),
        Mutant(
            "LOST_BODY_NS: Final = 900_000_000",
            "LOST_BODY_NS: Final = 9_000_000_000",
            "a body that came too late counts as heard",
        ),
        Mutant("TRIES: Final = 3", "TRIES: Final = 1", "a machine that stalls once is a fault"),
        Mutant(
            "IDLE_NS: Final = 1_100_000_000",
            "IDLE_NS: Final = 100_000_000",
            "a controller out of sync stays deaf in a slow stream",
        ),
        Mutant("EARLY_SHARE: Final = 8", "EARLY_SHARE: Final = 1", "zeros fill every pause of a stream"),
        Mutant(
            "            if self.announces:\n                with self._bus_lock():\n                    self._resynchronise()\n        except",
            "            pass\n        except",
            "the first frames after opening may not be heard",
        ),
        Mutant(
            "            if self.announces:\n                with self._bus_lock():\n                    self._resynchronise()\n        except",
            "            with self._bus_lock():\n                self._resynchronise()\n        except",
            "in plain framing, zeros are written that nobody asked for",
        ),
        Mutant(
            "            self.errors += 1\n            self.close()\n            raise\n",
            "            self.errors += 1\n            raise\n",
            "a device that failed while it was opened is used",
        ),
        Mutant(
            "            self.errors += 1\n            self.close()\n            raise\n",
            "            self.close()\n            raise\n",
            "errors of opening are not counted",
        ),
        Mutant(
            "GuardedDevice(self._open_device(), self._framing)", "self._open_device()", "nothing checks what is written"
        ),
        Mutant(
            "        self.close()\n        try:\n            self._device",
            "        try:\n            self._device",
            "a descriptor is lost with each fault",
        ),
        Mutant("        self.frames += 1\n", "        self.frames += 2\n", "frames are counted wrongly"),
        Mutant(
            "                self._transfer(frame.to_bytes())\n        except SpiError as error:\n            self.errors += 1\n",
            "                self._transfer(frame.to_bytes())\n        except SpiError as error:\n",
            "failed frames are not counted",
        ),
        Mutant(
            "self._write_announced(frame, first_repeat=first_repeat)",
            "self._write_announced(frame, first_repeat=False)",
            "a repeated run of Stops finds a deaf controller",
        ),
        Mutant(
            "self._write_announced(frame, first_repeat=first_repeat)",
            "self._write_announced(frame, first_repeat=frame.is_stop)",
            "a first Stop waits for zeros",
        ),
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
        Mutant(
            "                with self._bus_lock():\n                    self._write_announced(",
            "                if True:\n                    self._write_announced(",
            "another program's frame comes between announcement and body",
        ),
        Mutant(
            "        with self._device.lock():\n            if self._shared_device:\n                self._pause(self._frame_gap_ns / 1e9)\n            yield",
            "        with self._device.lock():\n            yield",
            "no pause before the first frame beside another program",
        ),
        Mutant(
            "            yield\n            if self._shared_device:\n                self._pause(self._frame_gap_ns / 1e9)\n",
            "            yield\n",
            "no pause behind the last frame beside another program",
        ),
        Mutant(
            "            if self._shared_device:\n                self._pause(self._frame_gap_ns / 1e9)\n            yield",
            "            self._pause(self._frame_gap_ns / 1e9)\n            yield",
            "each Stop waits for a pause that nobody needs",
        ),
        Mutant(
            "                zeros_fault = self._fault_of_zeros()\n",
            "                self._resynchronise()\n",
            "a Stop is not even tried where a zero fails",
        ),
        Mutant(
            "        if zeros_fault is not None:\n",
            "        if False:\n",
            "a Stop that may not have been heard counts as written",
        ),
        Mutant(
            "            self._synchronised = False\n            raise Unheard",
            "            raise Unheard",
            "after zeros that failed, the next frame comes without a preamble",
        ),
        Mutant(
            "if first_repeat or not self._synchronised:",
            "if first_repeat:",
            "after a failed transfer, frames come that nobody hears",
        ),
        Mutant(
            "if first_repeat or not self._synchronised:",
            "if not self._synchronised:",
            "a repeated run of Stops finds a deaf controller",
        ),
        Mutant(
            "        if now_ns - self.ended_ns >= IDLE_NS:\n            self._synchronised_ns = now_ns\n",
            "",
            "each first frame after a pause waits for zeros that nobody needs",
        ),
        Mutant("overdue = self._resync_ns > 0 and now_ns", "overdue = now_ns", "resync_ms = 0 does not switch it off"),
        Mutant(
            "now_ns - self._synchronised_ns >= self._resync_ns\n        #",
            "False\n        #",
            "a stream without pauses is never synchronised again",
        ),
        Mutant(
            "return (overdue or 0 < self._zeros < PREAMBLE_ZEROS) and not frame.is_stop",
            "return overdue and not frame.is_stop",
            "a preamble is begun again and again and never ended",
        ),
        Mutant(
            "return (overdue or 0 < self._zeros < PREAMBLE_ZEROS) and not frame.is_stop",
            "return overdue or 0 < self._zeros < PREAMBLE_ZEROS",
            "a first Stop waits for zeros",
        ),
        Mutant(
            "            self._synchronised = False  # until the whole frame is written\n",
            "",
            "after an announcement without its body, frames come that nobody hears",
        ),
        Mutant(
            "if self._wait_for_gap() - announced_ns <= STALE_ANNOUNCEMENT_NS or",
            "if self._clock() - announced_ns <= STALE_ANNOUNCEMENT_NS or",
            "a stall in the pause before the body is not seen",
        ),
        Mutant("or attempt == TRIES:", "or False:", "on a machine that stalls again and again, a Stop is never tried"),
        Mutant(
            "if self.ended_ns - announced_ns < LOST_BODY_NS:", "if True:", "a body that came too late counts as heard"
        ),
        Mutant(
            "        for _ in range(TRIES + 1):\n",
            "        for _ in range(1):\n",
            "a Stop behind one zero that failed may not be heard",
        ),
        Mutant(
            "                fault = fault or error\n", "                pass\n", "nobody learns that the bus failed"
        ),
        Mutant(
            "            self._zero()\n\n    def _zero",
            "            self._zero()\n            break\n\n    def _zero",
            "one zero in place of sixteen",
        ),
        Mutant(
            "        self._synchronised = False  # if it fails, nobody knows what arrived\n",
            "",
            "after a zero that failed, a frame comes without a preamble",
        ),
        Mutant(
            "self._synchronised, self._zeros = synchronised, zeros + 1",
            "self._synchronised, self._zeros = synchronised, zeros + 2",
            "eight zeros in place of sixteen",
        ),
        Mutant(
            "= True, self.ended_ns, False",
            "= True, self._synchronised_ns, False",
            "zeros fill every pause of a stream",
        ),
        Mutant("= True, self.ended_ns, False", "= True, self.ended_ns, True", "zeros fill every pause of a stream"),
        Mutant(
            "        if now_ns < self._free_ns:\n            self._pause((self._free_ns - now_ns) / 1e9)\n",
            "        if now_ns < self._free_ns:\n",
            "no pause between two transfers: the controller misses the second",
        ),
        Mutant(
            "        self._zeros = 0\n        begun_ns",
            "        begun_ns",
            "a frame among the zeros counts as one of them",
        ),
        Mutant(
            "self._free_ns = self.ended_ns + self._frame_gap_ns",
            "self._free_ns = begun_ns + self._frame_gap_ns",
            "the gap is counted from a transfer's begin: the controller misses the next",
        ),
        Mutant(
            "            self.transfer_latency.record(self.last_transfer_ns)\n",
            "",
            "how long transfers take is not measured",
        ),
        Mutant(
            "frame_gap_ns=round(settings.frame_gap_us * 1000)",
            "frame_gap_ns=round(settings.frame_gap_us)",
            "spi.frame_gap_us is a thousandth of what it says",
        ),
        Mutant("resync_ns=round(settings.resync_ms * 1e6)", "resync_ns=0", "spi.resync_ms is ignored"),
        Mutant(
            "        shared_device=shared_device,\n        clock=clock,\n        pause=pause,\n    )\n",
            "        clock=clock,\n        pause=pause,\n    )\n",
            "stop-servos beside a gateway makes no pauses",
        ),
    ),
)

GUARD = Subject(
    "gateway/spi/guard.py",
    tests=("tests/unit/test_guard.py", "tests/unit/test_guard_agrees.py", "tests/unit/test_bus_device.py"),
    mutants=(
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
            "_ZEROS_FOR_A_BODY: Final = 16",
            "_ZEROS_FOR_A_BODY: Final = 13",
            "the rest of a body is left to the next frame",
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
        Mutant(
            "        announced_len, filled = self._checked(data)\n        self._announced_len, self._filled = None, 0\n",
            "        announced_len, filled = self._checked(data)\n",
            "after a failed transfer no Stop can be tried",
        ),
        Mutant(
            "        self._announced_len, self._filled = announced_len, filled\n",
            "        self._announced_len, self._filled = announced_len, 0\n",
            "a frame comes into the zeros of a body's place",
        ),
        Mutant(
            "        self._announced_len, self._filled = announced_len, filled\n",
            "        self._announced_len, self._filled = None, filled\n",
            "a body of another length than was announced passes",
        ),
        Mutant("        return self._device.lock()\n", "        raise NotImplementedError\n", "no frame is written"),
        Mutant("        self._device.close()\n", "        pass\n", "the device is never released"),
        Mutant("if self._announces and data == _ZERO:", "if data == _ZERO:", "a plain controller gets zeros"),
        Mutant(
            "filled = 0 if announced_len is None else self._filled + 1",
            "filled = self._filled + 1",
            "a Stop may not come into a preamble",
        ),
        Mutant(
            "if 0 < filled < _ZEROS_FOR_A_BODY else (None, 0)",
            "if 0 < filled <= _ZEROS_FOR_A_BODY else (None, 0)",
            "after a preamble no frame may come",
        ),
        Mutant("        if self._filled:\n", "        if False:\n", "a frame comes into the zeros of a body's place"),
        Mutant(
            "            if data not in _ANNOUNCEMENTS:\n",
            "            if len(data) != 1:\n",
            "a length that overruns the controller's memory is announced",
        ),
        Mutant("            return data[0], 0\n", "            return None, 0\n", "no body follows its announcement"),
        Mutant(
            "if announced_len is not None and len(data) != announced_len:",
            "if False:",
            "a body of another length than was announced passes",
        ),
        Mutant(
            "        if _is_frame(data):\n            return None, 0\n",
            "",
            "each frame costs four times as much",
            equivalent="only slower: whatever is a frame is decoded and written the same way",
        ),
        Mutant("        if data != canonical:\n", "        if False:\n", "a Stop with an angle passes"),
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
