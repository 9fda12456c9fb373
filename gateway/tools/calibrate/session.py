"""What `calibrate` does with each key, and what it shows. Waits only for the gateway's answers."""

from collections.abc import Callable
from typing import Final

from rich.text import Text

from gateway.core.calibration import AS_DRAWN, CalibrationError, ServoCalibration
from gateway.errors import GatewayError
from gateway.tools.calibrate.guide import COARSE_CDEG, FINE_CDEG, Guide
from gateway.tools.calibrate.held import Held
from schemas.robot import JOINTS, LEGS

_CHOOSE: Final = "11 … 63 and Enter: a servo   w: write and end   u: undo   q: leave, writing nothing"
_JOG: Final = (
    "← →: 1°   , .: 0.1°   =: it now stands at …   i: it goes the wrong way   [ ]: lowest, highest here\n"
    "d: as drawn   u: undo   Space, Esc: stop this servo"
)
_STEPS: Final = {"left": -COARSE_CDEG, "right": COARSE_CDEG, ",": -FINE_CDEG, ".": FINE_CDEG}
_MAX_TYPED: Final = 7


class Session:
    """One person's calibration. `write` sends the draft, and raises GatewayError where it is not taken."""

    def __init__(self, guide: Guide, held: Held, write: Callable[[], None], where: str) -> None:
        self._guide = guide
        self._held = held
        self._write = write
        self._where = where
        self._typed: str | None = ""
        """What is being typed: a servo or an angle; None: keys act at once."""
        self._asking = False
        """Whether the next key answers if the draft is to be written."""
        self.message = ""
        self.written = False

    # ---- keys

    def press(self, key: str) -> bool:
        """Act on one key; whether to go on. Space and Escape stop the servo, whatever is being typed."""
        if key in (" ", "escape"):
            self._stop()
            return True
        try:
            return self._act(key)
        except (CalibrationError, GatewayError) as fault:
            self.message = str(fault)
            return True

    def _act(self, key: str) -> bool:
        self.message = ""
        if self._asking:
            return self._answer(key)
        if self._typed is not None and (key.isdigit() or key in (".", "-", "backspace", "enter")):
            self._type(key)
            return True
        if key == "u":
            self.message = "taken back" if self._guide.undo() else "there is nothing to take back"
        elif self._guide.servo_id is not None:
            self._jog(key)
        elif key == "w":
            return self._ask()
        elif key in ("q", "\x03"):
            return False
        return True

    def _jog(self, key: str) -> None:
        if key in _STEPS:
            self._guide.jog(_STEPS[key])
            self._held.go(self._guide.command_deg)
        elif key == "=":
            self._typed = ""
        elif key == "i":
            self._guide.wrong_way()
        elif key == "[":
            self._guide.lowest_here()
        elif key == "]":
            self._guide.highest_here()
        elif key == "d":
            self._guide.as_drawn()
        elif key in ("q", "\x03"):
            self._stop()

    def _type(self, key: str) -> None:
        typed = self._typed or ""
        if key == "backspace":
            self._typed = typed[:-1]
        elif key != "enter":
            self._typed = (typed + key)[:_MAX_TYPED]
        elif self._guide.servo_id is None:
            self._typed = ""
            self._choose(typed)
        else:
            self._typed = None
            self._measured(typed)

    def _choose(self, typed: str) -> None:
        if not typed.isdecimal():
            raise CalibrationError("type a servo: the leg (1 to 6), then the joint (1 to 3), such as 32")
        self._guide.choose(int(typed))
        try:
            self._held.start(int(typed), self._guide.command_deg)
        except GatewayError:
            self._guide.leave()
            raise
        self._typed = None

    def _measured(self, typed: str) -> None:
        try:
            seen_deg = float(typed)
        except ValueError:
            raise CalibrationError("type the angle that you measure on the robot, such as 90 or 87.5") from None
        self._guide.stands_at(seen_deg)

    def _stop(self) -> None:
        self._asking = False
        self._guide.leave()
        self._typed = ""
        try:
            self._held.stop()
        except GatewayError as fault:
            self.message = f"NOBODY HAS CONFIRMED THE STOP ({fault}): switch the servos' power off"
        else:
            self.message = "stopped"

    def _ask(self) -> bool:
        if not self._guide.changed:
            self.message = "nothing has changed, so there is nothing to write; q leaves"
            return True
        self._asking = True
        return True

    def _answer(self, key: str) -> bool:
        self._asking = False
        if key != "y":
            self.message = "not written"
            return True
        self._write()
        self.written = True
        return False

    # ---- what it shows

    def turn(self) -> None:
        """Ten times a second: the servo may have been stopped by somebody else."""
        self._held.seen()
        if self._guide.servo_id is not None and not self._held.running:
            self.message = f"servo {self._guide.servo_id} does not run any more: {self._held.fault or 'it was stopped'}"
            self._guide.leave()
            self._typed = ""

    def picture(self) -> Text:
        """The whole screen."""
        text = Text(no_wrap=True)
        text.append(f"calibrate  {self._where}\n\n", "bold")
        text.append("leg   joint 1                   joint 2                   joint 3\n", "dim")
        for leg in LEGS:
            text.append(f" {leg}   ")
            for joint in JOINTS:
                self._cell(text, 10 * leg + joint)
            text.append("\n")
        text.append("\n")
        servo_id = self._guide.servo_id
        if self._asking:
            names = ", ".join(map(str, self._guide.changed))
            text.append(f"Write the calibration of servo {names}? y: yes   any other key: no\n", "bold black on yellow")
        elif servo_id is None:
            text.append(f"Servo: {self._typed}_\n{_CHOOSE}\n")
        else:
            shown, sent = self._guide.shown_deg, self._guide.command_deg
            text.append(f"servo {servo_id} RUNS at {shown:g}°", "bold black on green")
            text.append(f"  (commanded {sent:g}° of the calibration in force)\n")
            text.append(f"It now stands at: {self._typed}_  Enter\n" if self._typed is not None else f"{_JOG}\n")
        text.append(f"\n{self.message}\n", "bold")
        return text

    def _cell(self, text: Text, servo_id: int) -> None:
        words = _words(self._guide.draft[servo_id])
        changed = servo_id in self._guide.changed
        style = "reverse" if servo_id == self._guide.servo_id else "bold" if changed else ""
        text.append(f"{'*' if changed else ' '}{words:<24} ", style)


def _words(servo: ServoCalibration) -> str:
    if servo == AS_DRAWN:
        return "as drawn"
    way = " inverted" if servo.inverted else ""
    return f"{servo.trim_cdeg / 100:+g}°{way} {servo.min_cdeg / 100:g}…{servo.max_cdeg / 100:g}"
