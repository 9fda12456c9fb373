"""What `calibrate` does with each key. No key waits for the gateway: what does is done on a thread of its own.

Two threads come here, that of the keys and the one that draws, and what was begun for them; a lock is held for moments.
"""

import threading
from collections.abc import Callable
from enum import Enum, auto
from typing import Final

import zenoh

from gateway.errors import GatewayError, LeaseLostError
from gateway.people.tools.calibrate.guide import COARSE_CDEG, FINE_CDEG, Guide
from gateway.people.tools.calibrate.held_servo import HeldServo
from gateway.people.tools.calibrate.robot import ChangedMeanwhileError, Robot
from gateway.robot.core.calibration import CalibrationError
from gateway.robot.protocol.frames import MAX_ANGLE_CDEG
from gateway.text import visible
from schemas.robot import SERVO_IDS

STEPS: Final = {"left": -COARSE_CDEG, "right": COARSE_CDEG, "down": -FINE_CDEG, "up": FINE_CDEG}
_MAX_TYPED: Final = 7
_ERRORS: Final = (GatewayError, ValueError, zenoh.ZError, RuntimeError)
_ALONE: Final = "that came with other keys, as if pasted: press it again"


class Asks(Enum):
    """What the screen waits for."""

    SERVO = auto()
    """Which servo to test."""
    ANGLE = auto()
    """Where to start it; Enter does."""
    KEYS = auto()
    """What to do with the servo that runs."""
    MEASURED = auto()
    """At which angle it stands, measured on the robot."""
    WRITE = auto()
    LEAVE = auto()


class Session:
    """One person's calibration."""

    def __init__(self, guide: Guide, held: HeldServo, robot: Robot, changed: Callable[[], None] = lambda: None) -> None:
        """`changed` wakes whoever draws."""
        self.guide = guide
        self.held = held
        self._robot = robot
        self._changed = changed
        self.lock = threading.RLock()
        """For whoever looks at what is in here."""
        self.asks = Asks.SERVO
        self.typed = ""
        self._suggested = False
        """Whether `typed` is a suggestion, which the first digit replaces."""
        self.servo_id = 0
        """The one that was typed, before it is started."""
        self.message = ""
        self.busy = ""
        """What is being waited for."""
        self._when_stopped = ""
        """What to say once the Stop that was asked for is confirmed."""
        self._begun = 0
        """Counts what was begun; a Stop ends it, so that nothing starts afterwards."""

    @property
    def drives(self) -> bool:
        """Whether we hold the lease."""
        return self._robot.drives

    # ---- keys

    def press(self, key: str, *, alone: bool = True) -> bool:
        """Act on one key; whether to go on. Space stops all legs, whatever is being typed.

        `alone`: nothing else came with it. What starts a servo, or writes, must: it could be pasted text.
        """
        if key == " ":
            self.held.stop(all_legs=True)  # first: not even the lock stands between the key and the wire
        self.held.touched()
        with self.lock:
            self.message = ""
            try:
                return self._act(key, alone)
            except _ERRORS as fault:
                self.message = visible(str(fault))
                return True

    def _act(self, key: str, alone: bool) -> bool:
        if key == "ctrl-c":
            return False
        if key == " ":
            self._to_servo("all six legs are stopped")
        elif key == "escape" or (key == "q" and self.asks not in (Asks.SERVO, Asks.LEAVE)):
            self._back()
        elif self.busy:
            self.message = f"{self.busy} Space or Esc gives it up"
        elif self.asks in (Asks.WRITE, Asks.LEAVE):
            return self._answer(key, alone)
        elif self.asks is Asks.KEYS and key in STEPS:
            self._jog(key)
        elif self.asks is not Asks.KEYS and (key.isdecimal() or key in (".", "-", "backspace", "enter")):
            self._type(key, alone)
        elif key == "u":
            servo_id = self.guide.undo()
            self.message = "there is nothing to take back" if servo_id is None else f"servo {servo_id}: taken back"
        elif self.asks is Asks.KEYS:
            self._say(key)
        elif self.asks is Asks.SERVO:
            return self._whole(key)
        return True

    def _back(self) -> None:
        if self.asks is Asks.MEASURED:
            self.asks, self.typed = Asks.KEYS, ""
        elif self.asks in (Asks.WRITE, Asks.LEAVE):
            self.asks, self.message = Asks.SERVO, "not written" if self.asks is Asks.WRITE else ""
        else:
            self._to_servo("" if self.guide.servo_id is None else f"servo {self.guide.servo_id} is stopped")

    def _to_servo(self, stopped: str = "") -> None:
        """Another servo may be chosen. `stopped` is said once that is confirmed."""
        if self.held.holding.running:  # also one that was started a moment ago
            self.held.stop()
        self._begun += 1
        self.busy = ""
        self.guide.leave()
        self.asks, self.typed = Asks.SERVO, ""
        self._when_stopped = stopped

    def _jog(self, key: str) -> None:
        before = self.guide.command_deg
        try:
            self.guide.jog(STEPS[key])
        except CalibrationError as fault:
            servo = self.guide.in_force.of(self.guide.servo_id or 0)
            if (servo.min_cdeg, servo.max_cdeg) == (0, MAX_ANGLE_CDEG):
                raise
            raise CalibrationError(f"{fault}. To open its limits: f, then Space, then w") from fault
        if not self.held.go(self.guide.command_deg):
            self.guide.back_to(before)  # the step before is still on its way; this one is left out

    def _say(self, key: str) -> None:
        """What the person says of the servo that runs."""
        guide = self.guide
        if key == "=":
            self.asks, self.typed = Asks.MEASURED, ""
        elif key == "i":
            guide.wrong_way()
            self.message = "turned round: → now has to be the way in which its angle grows"
        elif key == "[":
            guide.lowest_here()
            self.message = f"lowest angle: {guide.shown_deg:g}°"
        elif key == "]":
            guide.highest_here()
            self.message = f"highest angle: {guide.shown_deg:g}°"
        elif key == "f":
            guide.full_range()
            self.message = "no limits of its own; to go beyond those in force, stop (Space) and write (w) first"
        elif key == "d":
            guide.as_drawn()
            self.message = "as drawn: no trim, not inverted, full range"

    def _type(self, key: str, alone: bool) -> None:
        suggested, self._suggested = self._suggested, False
        if key == "backspace":
            self.typed = self.typed[:-1]
        elif suggested and key != "enter":
            self.typed = key  # it replaces the suggestion
        elif key != "enter":
            self.typed = (self.typed + key)[:_MAX_TYPED]
        elif self.asks is Asks.SERVO:
            typed, self.typed = self.typed, ""
            self._choose(typed)
        elif self.asks is Asks.MEASURED:
            typed, self.typed = self.typed, ""
            self.asks = Asks.KEYS
            self.guide.stands_at(_angle(typed))
            self.message = f"trim {self.guide.draft[self.guide.servo_id or 0].trim_cdeg / 100:+g}°"
        elif not alone:
            self.message = _ALONE
        else:
            begin_deg = _angle(self.typed)
            self._begin(f"starting servo {self.servo_id} …", lambda: self._start(begin_deg))

    def _choose(self, typed: str) -> None:
        if typed not in map(str, SERVO_IDS):
            raise CalibrationError("type a servo: the leg (1 to 6), then the joint (1 to 3), such as 32")
        self.typed, self._suggested = f"{self.guide.begins_at(int(typed)):g}", True
        self.asks, self.servo_id = Asks.ANGLE, int(typed)

    def _whole(self, key: str) -> bool:
        if key == "w" and not self.guide.changed:
            self.message = "nothing has changed, so there is nothing to write; q leaves"
        elif key == "w":
            self.asks, self.typed = Asks.WRITE, ""
        elif key == "q":
            self.asks, self.typed = Asks.LEAVE, ""
            return bool(self.guide.changed)
        return True

    def _answer(self, key: str, alone: bool) -> bool:
        if key == "y" and not alone:
            self.message = _ALONE
        elif key == "y" and self.asks is Asks.LEAVE:
            return False
        elif key == "y":
            self.asks = Asks.SERVO
            self._begin("writing …", self._write)
        else:
            self._back()
        return True

    # ---- what waits for the gateway

    def _begin(self, busy: str, do: Callable[[], Callable[[], None]]) -> None:
        """Do it on a thread; what it returns is done with the lock, unless a Stop came before."""
        if self.held.stopping:
            self.message = "the Stop is not confirmed yet: wait a moment"
            return
        self.busy, self._begun = busy, self._begun + 1
        threading.Thread(target=self._run, args=(self._begun, do), name="begun", daemon=True).start()

    def _run(self, number: int, do: Callable[[], Callable[[], None]]) -> None:
        fault, done = "", None
        try:
            done = do()
        except _ERRORS as error:
            fault = visible(str(error))
        with self.lock:
            if number == self._begun:
                self.busy = ""
                try:
                    if done is not None:
                        done()
                except _ERRORS as error:
                    fault = visible(str(error))
                self.message = fault or self.message
        self._changed()

    def _start(self, begin_deg: float) -> Callable[[], None]:
        self._robot.drive()
        calibration = self._robot.calibration()

        def start() -> None:
            if calibration.revision != self.guide.in_force.revision:
                self._stands_on(ChangedMeanwhileError(calibration))
                return  # the angle was chosen on the old one
            self.guide.choose(self.servo_id, begin_deg)
            self.held.start(self.servo_id, self.guide.command_deg)
            self.asks, self.typed = Asks.KEYS, ""

        return start

    def _write(self) -> Callable[[], None]:
        with self.lock:
            guide = self.guide
            servos = {servo_id: guide.draft[servo_id] for servo_id in guide.changed}
            landing: dict[int, int | None] = dict.fromkeys(guide.landing_left_out)
            lands = [servo_id for servo_id in servos if servo_id in guide.in_force.landing_cdeg]
            revision = guide.in_force.revision
        try:
            written = self._robot.write(servos, landing, revision)
        except ChangedMeanwhileError as changed:
            newer = changed
            return lambda: self._stands_on(newer)

        def note() -> None:
            self.guide.now_in_force(written)
            self.message = f"written: revision {written.revision}"
            if lands:
                self.message += f"; the landing pose names servo {_and(lands)}: does it still fit?"

        return note

    def _stands_on(self, changed: ChangedMeanwhileError) -> None:
        """Somebody else was faster. The person sees what comes of both, and then writes it, or not."""
        wanted = self.guide.changed
        both = self.guide.now_in_force(changed.newer)
        self.asks, self.typed = Asks.SERVO, ""
        self.message = f"NOT DONE: {changed}. "
        if not self.guide.changed:
            self.message += "It says what you wanted" if wanted else "The table shows it"
        else:
            self.message += f"Your changes of servo {_and(self.guide.changed)} stand on it now; w writes them, q leaves"
        if both:
            self.message += f". Both of you changed servo {_and(both)}: the table has yours"

    # ---- what others do

    def lost(self, error: LeaseLostError) -> None:
        """The lease is lost; called on a thread of its own."""
        if error.holder is None:
            self.held.stop()
        else:
            self.held.forget()  # whoever took it has stopped all legs, and may drive this one by now
        with self.lock:
            ran = self.guide.servo_id is not None
            self._to_servo()
            self.message = visible(f"THE LEASE IS LOST{', and the servo is stopped' * ran}: {error.detail}")
        self._changed()

    def turn(self) -> None:
        """Ten times a second: the gateway, or somebody else, may have changed something."""
        self.held.seen()
        rejected = self.held.rejected_step()
        if self._when_stopped and not self.held.stopping:
            self.message = self.message or self._when_stopped * (self.held.holding.unconfirmed is None)
            self._when_stopped = ""
        if self.guide.servo_id is None:
            return
        if not self.held.holding.running:
            servo_id, shown_deg = self.guide.servo_id, self.guide.shown_deg
            self._to_servo()
            self.message = f"servo {servo_id} does not run any more: {self.held.holding.fault or 'it was stopped'}"
            if not self.held.holding.has_run:
                self.message = f"servo {servo_id} is not started: {self.held.holding.fault}"
                self.asks, self.typed = Asks.ANGLE, f"{shown_deg:g}"
        elif rejected is not None:
            self.message, angle_deg = rejected
            self.guide.back_to(angle_deg)


def _angle(typed: str) -> float:
    try:
        return float(typed)
    except ValueError:
        raise CalibrationError("type an angle in degrees, such as 90 or 87.5") from None


def _and(servo_ids: list[int]) -> str:
    return ", ".join(map(str, servo_ids))
