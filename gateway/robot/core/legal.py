"""The events that the supervisor accepts in each mode. Pure."""

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
"""An interlock's event that is not listed here is legal in every mode."""
LEGAL: Final = {mode: ALL_EVENTS - {BusOpened, EstopKept} for mode in (Mode.IDLE, Mode.ACTIVE)} | {
    Mode.ESTOPPED: ALL_EVENTS - {BusOpened},
    Mode.STARTING: _AT_START,
    Mode.BUS_FAULT: ALL_EVENTS,
    Mode.STOPPING: ALL_EVENTS,
}
"""The events that each mode accepts. Any other is a mistake of the caller."""


class IllegalEvent(RuntimeError):  # noqa: N818  (h11 and friends: it names what happened)
    """The caller sent an event that this mode does not accept; the state is unchanged."""
