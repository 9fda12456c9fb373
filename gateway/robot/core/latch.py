"""The latch of the emergency stop: whether it is engaged, and which reset leaves it. Pure."""

from typing import Final

from gateway.allowance import NS_PER_S
from gateway.robot.core.events import Effect, EstopKept
from gateway.robot.core.leg import Rules

_UNKNOWN: Final = "it is not known yet whether an earlier run has left an emergency stop engaged"


class Latch:
    """What is known of the emergency stop. The supervisor sets the attributes; no call precedes its Stops."""

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self.number = 0
        """Of the latest emergency stop; 0: there was none. A run goes on from the last number of the run before."""
        self.since_ns: int | None = None
        """The instant of the latest emergency stop; None: none is engaged."""
        self.unknown = rules.estop_kept
        """Whether an earlier run may have left it engaged. Until `EstopKept` it counts as engaged."""

    def kept(self, event: EstopKept, instant_ns: int) -> list[Effect]:
        """Take what an earlier run has left. The emergency stops of this run come behind it. Has no effects."""
        self.unknown = False
        self.number += event.number
        if event.engaged and self.since_ns is None:
            self.since_ns = instant_ns
        return []

    def why_not_left(self, names: int | None, instant_ns: int) -> str | None:
        """Return why a reset does not leave it; None: it does, or none is engaged.

        A reset may have been sent before the latest emergency stop. `names` is the number of the emergency stop that it
        leaves; None: it does not say.
        """
        if self.unknown or self.since_ns is None:
            return _UNKNOWN if self.unknown else None
        age_ns = instant_ns - self.since_ns
        if age_ns == 0:
            return "the emergency stop was engaged in the same instant"
        if names is None:
            if age_ns >= self._rules.unnumbered_reset_ns:
                return None
            return (
                f"the emergency stop was requested {age_ns / NS_PER_S:.1f} s ago; a reset without its number (estop) "
                f"is accepted after {self._rules.unnumbered_reset_ns / NS_PER_S:g} s"
            )
        if names == self.number:
            return None
        what = "a newer" if names < self.number else "no such"
        return f"{what} emergency stop was requested: estop is {names}, and the latest is {self.number}"
