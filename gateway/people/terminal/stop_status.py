"""The text that a terminal shows about an emergency stop requested by a key. Pure: `now_ns` is monotonic."""

from typing import Final, NamedTuple

from gateway.people.client.dangers import PowerAlarm, confirmed_off
from schemas.robot import LEGS
from schemas.telemetry import Ack

ALARM: Final = "bold white on red"
PATIENCE_NS: Final = 500_000_000
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
        self._pressed_ns = 0
        self._tries = 0

    def press(self, now_ns: int) -> None:
        """A Stop key was pressed."""
        self.outcome = None
        if self.wanted_ns is None:
            self.wanted_ns = self._pressed_ns = now_ns
            self._tries = 0

    def unanswered(self) -> None:
        """Nobody confirmed a request in time; it is sent again."""
        self._tries += 1

    def confirm(self, ack: Ack, newer_ns: int | None, now_ns: int) -> None:
        """The gateway confirms the presses before `newer_ns`; None: all of them."""
        frames = ack.stop_frames or 0
        took_ms = (now_ns - self._pressed_ns) / 1e6
        self.wanted_ns = newer_ns
        self.power.answered(ack)
        if newer_ns is not None:
            self._pressed_ns, self._tries = newer_ns, 0
        if frames >= len(LEGS) and ack.latency_us is not None:
            text = (
                f"STOPPED: {frames} Stop frames written within {ack.latency_us:.0f} µs of the request, "
                f"confirmed {took_ms:.0f} ms after the key{confirmed_off(ack)}"
            )
            self.outcome = Remark(text, False, now_ns)
        else:
            text = f"LATCHED, BUT ONLY {frames} OF {len(LEGS)} STOP FRAMES WERE WRITTEN: switch the servos' power off"
            self.outcome = Remark(text, True, now_ns)

    def reset(self) -> None:
        """The person asks for the reset, so no Stop is wanted."""
        self.wanted_ns = self.outcome = None

    def alarm(self, now_ns: int) -> str | None:
        """Return the alarm about a Stop that nobody confirms, or None."""
        if self.wanted_ns is None or (not self._tries and now_ns - self.wanted_ns < PATIENCE_NS):
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
