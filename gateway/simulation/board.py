"""A simulated power board: it answers, switches, blocks and errs as its firmware does. Pure; time is an argument.

* A receive interrupt takes a frame at once. It answers questions, and switches off the outputs that a mask leaves out.
* A main loop makes a pass every 1 to 2 ms. It counts the passes since a change was pending. In the 26th it switches on
  the first wanted output that is off, and counts again. If none is left, it sends the mask (6B). So a mask without a
  new output is answered after 26 passes, one with 18 new outputs after 19 times 26.
* The firmware counts once more after an answer, and resets the counter only in a pass without a pending change. A mask
  that arrives in that one pass finds 26 where the firmware compares with 25: its 8 bits wrap, which takes 256 passes.
* An output over the current limit in ten measurements in a row is switched off and blocked. Up to four kinds of error
  wait in a queue: each 64 shows the next one, and 96 deletes the one shown last. **Blocked outputs of the newest mask
  then go on by themselves**, also if somebody deletes the error at the board's own buttons.
* A sensor at 70 °C switches converters off: the first one 1 to 3, the second 5, the third 4. Meanwhile the board shows
  this error every 140 ms.
* A power cut erases everything. The board is then in standby, and receives nothing until its button is pressed.
  Switched off by 66, it keeps its state: the previous mask applies once something changes.

Not simulated: the buzzer, the manipulator's converter, the other outputs, and the converters' settings.
"""

import struct
from collections.abc import Iterable
from typing import Final

from gateway.model import power_board as wire
from gateway.model.power_board import OUTPUTS, CanFrame

PASS_NS: Final = 1_500_000
"""The firmware waits for 1 ms, and then works for less than 1 ms."""
WAITS_FOR: Final = 25
"""The counter's value in the pass that acts, the 26th."""
COUNTER: Final = 256
"""Values of its 8 bits."""
MEASURE_NS: Final = 10_000_000
"""Assumed: the firmware's timer is set in a file that is not published."""
LIMIT_MA: Final = 3950.0
MEASUREMENTS: Final = 10
"""This many in a row above the limit block an output."""
AWAKE_NS: Final = 160_000_000
"""Time from the button to the first accepted frame: ten delays of the firmware, one of them 150 ms."""
OFF_PASSES: Final = 1000
"""Passes of the firmware's loop from frame 66 to standby."""
SERVO_MV: Final = 7400
"""Setting of converters 1 to 3 at the start."""
BATTERY_MV: Final = 14_800
FIVE_VOLT_MA: Final = 900
THREE_VOLT_MA: Final = 60
STANDBY_MA: Final = 20
TEMPERATURE_C: Final = 30
"""Assumed, like the values above from the battery on."""
TOO_HOT_C: Final = 70
_HOT_CONVERTERS: Final = (0b00111, 0b10000, 0b01000)
"""Which converters each temperature sensor switches off."""
HOT_NS: Final = 140_000_000
"""The period of frame 65 during an overtemperature."""

_POWER_OFF: Final = CanFrame(0x66)
_MASK_BYTES: Final = {wire.CONVERTER_OVERCURRENT: 1, wire.OVERTEMPERATURE: 1, wire.SERVO_OVERCURRENT: 3}


class SimulatedBoard:
    """The board, awake and with all outputs off. Masks: bit n - 1 is output n. One thread at a time."""

    def __init__(self, now_ns: int = 0, *, pass_ns: int = PASS_NS) -> None:
        """`pass_ns`: the length of a pass, always the same."""
        self.draws_ma = [0.0] * OUTPUTS
        """The current of each output while it has supply. Callers set this, `battery_mv` and `temperatures_c`."""
        self.battery_mv = BATTERY_MV
        self.temperatures_c = [TEMPERATURE_C] * 3
        self.stuck = 0
        """A fault, the mask of outputs that always have supply, as after a welded switch."""

        self._pass_ns = pass_ns
        self._pass_due_ns = now_ns + pass_ns
        self._measure_due_ns = now_ns + MEASURE_NS
        self._hot_due_ns = now_ns
        self._awake_ns: int | None = now_ns
        """When it begins to accept frames; None: in standby."""
        self._forget()

    def _forget(self) -> None:
        self._wanted = self._on = self._blocked = self._off_converters = 0
        self._switches = False
        self._count = 0
        self._errors: dict[int, int] = {}
        """By code, the newest first: the mask of outputs with SERVO_OVERCURRENT, of converters with other codes."""
        self._next_shown = self._shown = 0
        self._clearable = True
        self._show = self._say_cleared = self._say_pressed = False
        self._off_passes = 0
        self._measured_ma = [0.0] * OUTPUTS
        self._too_much = [0] * OUTPUTS

    # ---- what a person at the board sees and does

    @property
    def fed(self) -> int:
        """The mask of the outputs that have supply now."""
        off = sum(fed for place, fed in enumerate(wire.OUTPUTS_OF_CONVERTER) if self._off_converters >> place & 1)
        return self._on & ~off | self.stuck

    @property
    def due_ns(self) -> int:
        """When the board next acts by itself, in ns: call `advance` then."""
        if self._show or self._say_cleared or self._say_pressed or self._off_passes:
            return min(self._measure_due_ns, self._pass_due_ns)
        if self._switches:
            passes = (WAITS_FOR - self._count) % COUNTER
            return min(self._measure_due_ns, self._pass_due_ns + passes * self._pass_ns)
        return self._measure_due_ns

    def press_button(self, now_ns: int) -> None:
        """Press the power button: the board reports this (69) if it is awake, and wakes from standby."""
        if self._awake_ns is None:
            self._awake_ns = now_ns + AWAKE_NS
        else:
            self._say_pressed = True

    def restart(self) -> None:
        """Interrupt the board's own supply."""
        self._forget()
        self._awake_ns = None

    def fail(self, code: int, mask: int = 0) -> None:
        """Let the board find an error. `mask`: its outputs with wire.SERVO_OVERCURRENT, else its converters."""
        known = self._errors.pop(code, None)
        self._errors = {code: mask | (known or 0), **self._errors}
        self._show = self._show or self._errors[code] != known
        self._next_shown = 0
        self._apply_blocks()

    def clear_by_hand(self) -> None:
        """Hold the board's button that deletes the newest error."""
        self._delete(0)

    # ---- the firmware

    def take(self, frame: CanFrame, now_ns: int) -> list[CanFrame]:
        """Receive a frame. Return all frames sent since the last call, the answer last."""
        sent = self.advance(now_ns)
        if not self._is_awake(now_ns):
            return sent
        if frame.id == wire.SET_SUPPLY and len(frame.data) == 3:
            self._wanted = int.from_bytes(frame.data, "big") & wire.ALL
            self._retarget()
        elif frame in wire.ASK_CURRENTS:
            first = 3 * wire.ASK_CURRENTS.index(frame)
            sent.append(CanFrame(frame.id + 1, _numbers(self._measured_ma[first : first + 3])))
        elif frame in wire.ASK_RAILS:
            sent.append(CanFrame(frame.id + 1, self._rail(frame.id)))
        elif frame == wire.ASK_ERROR:
            self._show = True
        elif frame == wire.CLEAR_ERROR and self._clearable and self._errors:
            self._delete(self._shown)
            self._clearable, self._say_cleared = False, True
        elif frame == _POWER_OFF:
            self._off_passes = self._off_passes or 1
            sent.append(CanFrame(frame.id + 1))
        return sent

    def advance(self, now_ns: int) -> list[CanFrame]:
        """Make the passes and measurements due up to now. Return the frames sent meanwhile, in order."""
        sent: list[CanFrame] = []
        while (due_ns := min(self._pass_due_ns, self._measure_due_ns)) <= now_ns:
            if due_ns == self._measure_due_ns:
                self._measure_due_ns += MEASURE_NS
                if self._is_awake(due_ns):
                    self._measure(due_ns)
            else:
                self._pass_due_ns += self._pass_ns
                if self._is_awake(due_ns):
                    sent += self._make_pass()
        return sent

    def _is_awake(self, now_ns: int) -> bool:
        return self._awake_ns is not None and self._awake_ns <= now_ns

    def _make_pass(self) -> list[CanFrame]:
        if self._off_passes > OFF_PASSES:
            self._on = self._off_passes = 0
            self._awake_ns = None
            return []
        self._off_passes += self._off_passes > 0
        sent = []
        if self._switch_in_turn():
            sent.append(CanFrame(wire.SUPPLIED, self._on.to_bytes(3, "big")))
        if self._say_pressed:
            sent.append(CanFrame(wire.OFF_PRESSED))
        if self._show:
            data = b""
            if self._errors:
                self._clearable = True
                self._shown = self._next_shown
                self._next_shown = (self._next_shown + 1) % len(self._errors)
                code, mask = list(self._errors.items())[self._shown]
                data = bytes((code,)) + mask.to_bytes(_MASK_BYTES.get(code, 0), "big")
            sent.append(CanFrame(wire.ERROR, data))
        if self._say_cleared:
            sent.append(CanFrame(wire.CLEARED))
        self._say_pressed = self._show = self._say_cleared = False
        return sent

    def _switch_in_turn(self) -> bool:
        """Switch on at most one output. Return True once when none is left."""
        if not self._switches:
            self._count = 0
            return False
        if self._count == WAITS_FOR:
            left = self._wanted & ~self._blocked & ~self._on
            if left:
                self._on |= left & -left
                self._count = 0
                return False
            self._switches = False
        self._count = (self._count + 1) % COUNTER  # after the answer, too
        return not self._switches

    def _retarget(self) -> None:
        self._on &= self._wanted & ~self._blocked
        self._switches = True

    def _apply_blocks(self) -> None:
        self._blocked = self._off_converters = 0
        for code, mask in self._errors.items():
            if code == wire.SERVO_OVERCURRENT:
                self._blocked |= mask
            elif code in (wire.CONVERTER_OVERCURRENT, wire.OVERTEMPERATURE):
                self._off_converters |= mask
        self._retarget()

    def _delete(self, place: int) -> None:
        if place < len(self._errors):
            del self._errors[list(self._errors)[place]]
            self._next_shown = max(0, min(self._next_shown, len(self._errors) - 1))
            self._apply_blocks()

    # ---- what it measures

    def _measure(self, now_ns: int) -> None:
        hot = sum(each for each, c in zip(_HOT_CONVERTERS, self.temperatures_c, strict=True) if c >= TOO_HOT_C)
        if hot and now_ns >= self._hot_due_ns:
            self._hot_due_ns = now_ns + HOT_NS
            self.fail(wire.OVERTEMPERATURE, hot)
            self._show = True
        fed = self.fed
        for place in range(OUTPUTS):
            drawn_ma = self._measured_ma[place] = self.draws_ma[place] if fed >> place & 1 else 0.0
            self._too_much[place] = self._too_much[place] + 1 if drawn_ma > LIMIT_MA else 0
            if self._too_much[place] >= MEASUREMENTS:
                self.fail(wire.SERVO_OVERCURRENT, 1 << place)

    def _rail(self, question: int) -> bytes:
        """Return the answer, in mA, mV or °C."""
        if question == wire.TEMPERATURES_C:
            return struct.pack(">3h", *self.temperatures_c)
        one, two, three = (0 if self._off_converters >> place & 1 else SERVO_MV for place in range(3))
        power_uw = SERVO_MV * sum(self._measured_ma) + 5000 * FIVE_VOLT_MA + 3300 * THREE_VOLT_MA
        rails: dict[int, tuple[float, ...]] = {
            wire.MANIPULATOR_5V_3V3_MA: (0, FIVE_VOLT_MA, THREE_VOLT_MA),
            wire.STANDBY_SUPPLY_MA: (STANDBY_MA, power_uw / self.battery_mv),
            wire.CONVERTERS_1_TO_3_MV: (one, two, three),
            wire.CONVERTERS_4_5_MV: (0, 5000),
            wire.SUPPLY_BATTERY_MV: (self.battery_mv, self.battery_mv),
        }
        return _numbers(rails[question])


def _numbers(values: Iterable[float]) -> bytes:
    """Return each value truncated, limited to 16 bits, big-endian."""
    return b"".join(max(0, min(int(value), 0xFFFF)).to_bytes(2, "big") for value in values)
