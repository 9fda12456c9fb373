"""Decides what means danger to people near the robot, for page, terminals and recordings. Pure.

`now_ns` is monotonic.
"""

from typing import Final, Literal, NamedTuple

from schemas.ack import Ack
from schemas.gateway_state import GatewayState, PowerReport
from schemas.robot import LEGS
from schemas.words import AnyKind, Kind, Mode

Tone = Literal["bad", "warn", "plain"]

_BAD: Final = {
    *(kind for kind in Kind if kind.stops and kind is not Kind.LEGS_STOPPED),
    *(Kind.BUS_MEDDLED, Kind.BUTTON_SILENT),
    *(Kind.POWER_CUT, Kind.POWER_UNCONFIRMED, Kind.POWER_FAULT, Kind.SERVO_DRAWS),
}
"""Events of a stop that nobody commanded leg by leg, or of one that may not have worked."""
_WARN: Final = {Kind.COMMAND_REJECTED, Kind.BATTERY_LOW, Kind.SERVO_SILENT, Kind.ESTOP_KEPT, Kind.ESTOP_NOT_KEPT}

UNCONFIRMED: Final = "STOP is not confirmed: switch the power off by hand."
PATIENCE_NS: Final = 300_000_000
"""The board confirms within 27 to 55 ms; by default the gateway reports after 150 ms that it has not. A state that is
published meanwhile is no alarm. Without an event, two states without a confirmation, so far apart, are an alarm."""


def tone_of(kind: AnyKind) -> Tone:
    """Return the tone of an event of this kind; a later gateway's unknown kind is plain."""
    return "bad" if kind in _BAD else "warn" if kind in _WARN else "plain"


class PowerAlarm:
    """The alarm for a Stop that the power board has not confirmed. A robot without a board has none.

    A board that has never answered may be in standby with everything off; its silence is an alarm only in an emergency
    stop. A board that has answered may power servos, so its silence is an alarm at once.
    """

    def __init__(self) -> None:
        self.sentence = ""
        """The alarm for people, or ""."""
        self._since_ns: int | None = None
        """When the first of the unconfirmed states was received."""

    def received_state(self, state: GatewayState, now_ns: int) -> None:
        """Take the newest state, received at `now_ns` (monotonic)."""
        power = state.power
        if power is None or (power.alive and power.confirmed):
            self.sentence, self._since_ns = "", None
        elif power.alive:
            self._since_ns = now_ns if self._since_ns is None else self._since_ns
            if now_ns - self._since_ns >= PATIENCE_NS:
                self.sentence = UNCONFIRMED
        elif power.age_ms is not None or state.mode == Mode.ESTOPPED:
            self.sentence = UNCONFIRMED

    def received_event(self, kind: AnyKind) -> None:
        """Take an event of this kind. Its alarm ends with a state in which the board confirms."""
        if kind == Kind.POWER_UNCONFIRMED:
            self.sentence = UNCONFIRMED

    def answered(self, ack: Ack) -> None:
        """Take the answer to a Stop. If that Stop leaves the power on, the next state ends the alarm."""
        if ack.confirmed is not None:
            self.sentence = "" if ack.confirmed else UNCONFIRMED


def confirmed_off(ack: Ack) -> str:
    """Return the end of a sentence, `, power confirmed off after 34 ms`, or "" without a confirmation."""
    after = "" if ack.confirmed_ms is None else f" after {ack.confirmed_ms:.0f} ms"
    return f", power confirmed off{after}" if ack.confirmed else ""


def power_now(power: PowerReport | None) -> str:
    """Return how the board powers the servos, in a few words, or "" without a board."""
    if power is None:
        return ""
    if not power.alive:
        return "does not answer"
    fed = f"{len(power.supplied)} fed" if power.supplied else ""
    if not power.confirmed:
        return ", ".join(("off not confirmed", *([fed] if fed else [])))
    return fed or "confirmed off"


ALARM: Final = "bold white on red"
KEY_PATIENCE_NS: Final = 500_000_000
"""A Stop takes milliseconds. If its confirmation takes longer, the person must go to the power switch."""
SHOWN_NS: Final = 15_000_000_000
"""How long a success is shown. A failure stays until another key is pressed."""


class Remark(NamedTuple):
    """One sentence for the person who pressed a key."""

    text: str
    is_bad: bool
    """Not a success: it is shown until its cause is over, or another key is pressed."""
    since_ns: int = 0

    @property
    def style(self) -> str:
        """The text's style for rich."""
        return ALARM if self.is_bad else "bold green"

    def is_over(self, now_ns: int) -> bool:
        """Return whether the status has been shown for long enough."""
        return not self.is_bad and now_ns - self.since_ns > SHOWN_NS


class StopStatus:
    """A Stop is wanted from the press until it is confirmed, or until the same person asks for the reset."""

    def __init__(self) -> None:
        self.wanted_ns: int | None = None
        """Since when a Stop is requested and not confirmed, or None."""
        self.outcome: Remark | None = None
        """The result of the latest confirmed request."""
        self.power = PowerAlarm()
        """Whether the power board confirms it. The shell passes states and events to it."""
        self._tries = 0

    def press(self, now_ns: int) -> None:
        self.outcome = None
        if self.wanted_ns is None:
            self.wanted_ns = now_ns
            self._tries = 0

    def unanswered(self) -> None:
        """Nobody confirmed a request in time; it is sent again."""
        self._tries += 1

    def confirm(self, ack: Ack, newer_ns: int | None, now_ns: int) -> None:
        """The gateway confirms the presses before `newer_ns`; None: all of them."""
        frames = ack.stop_frames or 0
        took_ms = (now_ns - (now_ns if self.wanted_ns is None else self.wanted_ns)) / 1e6
        self.wanted_ns, self._tries = newer_ns, 0
        self.power.answered(ack)
        is_whole = frames >= len(LEGS) and ack.latency_us is not None
        if is_whole:
            text = (
                f"STOPPED: {frames} Stop frames written within {ack.latency_us:.0f} µs of the request, "
                f"confirmed {took_ms:.0f} ms after the key{confirmed_off(ack)}"
            )
        else:
            text = f"LATCHED, BUT ONLY {frames} OF {len(LEGS)} STOP FRAMES WERE WRITTEN: switch the servos' power off"
        self.outcome = Remark(text, not is_whole, now_ns)

    def reset(self) -> None:
        """The person asks for the reset, so no Stop is wanted."""
        self.wanted_ns = self.outcome = None

    def alarm(self, now_ns: int) -> str | None:
        """Return the alarm about a Stop that nobody confirms, or None."""
        if self.wanted_ns is None or (not self._tries and now_ns - self.wanted_ns < KEY_PATIENCE_NS):
            return None
        waited_s = (now_ns - self.wanted_ns) / 1e9
        return f"NOT STOPPED, NO ANSWER for {waited_s:.0f} s: switch the servos' power off; trying again"

    def remark(self, now_ns: int) -> Remark | None:
        """Return the sentence to show: an unconfirmed Stop, or the result of the last one; None: nothing."""
        if (alarm := self.alarm(now_ns)) is not None:
            return Remark(alarm, True)
        if self.wanted_ns is not None:
            return Remark("EMERGENCY STOP sent, waiting for its confirmation", True)
        if self.power.sentence:
            return Remark(self.power.sentence, True)
        return None if self.outcome is None or self.outcome.is_over(now_ns) else self.outcome
