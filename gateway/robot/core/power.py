"""What the power board's answers allow, and which servos it is to feed. Pure.

A servo that is not fed must not count as running: fed again, it would jump to its angle, and nobody asked for that. So
what the board feeds no longer is stopped on the wire as well, and a start is needed.
"""

from collections.abc import Collection, Mapping
from enum import StrEnum
from typing import Final

from gateway.robot.core.events import PowerSeen, Targets
from gateway.robot.core.leg import Rules
from schemas.telemetry import Mode, Reason

SILENT: Final = "the power board does not answer"
LOST: Final = "the power board does not feed it any more"


class CutOn(StrEnum):
    """What takes the servos' supply (`power.cut_on`)."""

    ESTOP = "estop"
    BUS_FAULT = "bus_fault"
    BUTTON = "button"
    SHUTDOWN = "shutdown"
    UNCONFIRMED = "unconfirmed"


_IN_MODE: Final = {
    Mode.ESTOPPED: CutOn.ESTOP,
    Mode.BUS_FAULT: CutOn.BUS_FAULT,
    Mode.STOPPING: CutOn.SHUTDOWN,
}


def cut_by(mode: Mode, cut_on: Collection[str], *, unwatched: bool) -> CutOn | None:
    """What takes the supply of all servos now; None: nothing does. `unwatched`: too few buttons, and nothing runs."""
    cause = _IN_MODE.get(mode)
    if cause in cut_on:
        return cause
    return CutOn.BUTTON if unwatched and CutOn.BUTTON in cut_on else None


class PowerRule:
    """Whether the board feeds what is to move. One owner, one thread."""

    def __init__(self, rules: Rules) -> None:
        self.alive = not rules.power
        self.closed = rules.power
        """Whether it stands in the way of any move."""
        self._refused: Mapping[int, str] = {}

    def note(self, event: PowerSeen) -> None:
        """Take what the board has said, or that it says nothing."""
        self.alive, self._refused = event.alive, dict(event.refused)
        self.closed = not event.alive or bool(event.refused)

    def rejection(self, moves: Targets) -> tuple[Reason, str] | None:
        """Why these starts and sets take no effect; None: they may."""
        if not self.alive:
            return Reason.NO_POWER, SILENT
        for servo_id, _ in moves:
            if servo_id in self._refused:
                return Reason.NO_POWER, f"servo {servo_id} is not fed: {self._refused[servo_id]}"
        return None
