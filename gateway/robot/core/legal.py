"""In which mode which event may come to the supervisor: pure."""

from typing import Final, get_args

from gateway.robot.core.events import (
    BodyMeasured,
    BusFailed,
    BusOpened,
    EmergencyStop,
    EstopKept,
    Event,
    PowerSeen,
    ShutDown,
    TimePassed,
)
from schemas.telemetry import Mode

_AT_START: Final[frozenset[type[Event]]] = frozenset(
    {EmergencyStop, EstopKept, BusOpened, BusFailed, BodyMeasured, PowerSeen, TimePassed, ShutDown}
)
ALL_EVENTS: Final[frozenset[type[Event]]] = frozenset(get_args(Event))
"""An interlock may take another one, which then may come at any time."""
LEGAL: Final = {mode: ALL_EVENTS - {BusOpened, EstopKept} for mode in (Mode.IDLE, Mode.ACTIVE)} | {
    Mode.ESTOPPED: ALL_EVENTS - {BusOpened},
    Mode.STARTING: _AT_START,
    Mode.BUS_FAULT: ALL_EVENTS,
    Mode.STOPPING: ALL_EVENTS,
}
"""In which mode which event may come; any other is a mistake of the caller. Tests have where each leads."""


class IllegalEvent(RuntimeError):  # noqa: N818  (h11 and friends: it names what happened)
    """The caller sent an event that has no place in this mode; the state is as it was."""
