"""In which mode which event may come to the supervisor, and where it leads: the table. Pure."""

from typing import Final, get_args

from gateway.robot.core.events import (
    BusFailed,
    BusOpened,
    ButtonRequest,
    Calibrate,
    Command,
    EmergencyStop,
    Event,
    Kept,
    LeaseRequest,
    Reset,
    ShutDown,
    StoppedOutside,
    TimePassed,
)
from schemas.telemetry import Mode

_QUIET: Final = frozenset({Mode.IDLE, Mode.ACTIVE})

TRANSITIONS: Final[dict[Mode, dict[type[Event], frozenset[Mode]]]] = {
    Mode.STARTING: {
        EmergencyStop: frozenset({Mode.STARTING}),
        BusOpened: frozenset({Mode.IDLE, Mode.ESTOPPED}),
        BusFailed: frozenset({Mode.BUS_FAULT}),
        TimePassed: frozenset({Mode.STARTING}),
        ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.IDLE: {
        Command: _QUIET,
        Reset: _QUIET,
        LeaseRequest: _QUIET,
        ButtonRequest: _QUIET,
        Calibrate: _QUIET,
        Kept: _QUIET,
        EmergencyStop: frozenset({Mode.ESTOPPED}),
        BusFailed: frozenset({Mode.BUS_FAULT}),
        StoppedOutside: _QUIET,
        TimePassed: _QUIET,
        ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.ACTIVE: {
        Command: _QUIET,
        Reset: _QUIET,
        LeaseRequest: _QUIET,
        ButtonRequest: _QUIET,
        Calibrate: _QUIET,
        Kept: _QUIET,
        EmergencyStop: frozenset({Mode.ESTOPPED}),
        BusFailed: frozenset({Mode.BUS_FAULT}),
        StoppedOutside: _QUIET,
        TimePassed: _QUIET,
        ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.ESTOPPED: {
        Command: frozenset({Mode.ESTOPPED}),
        Reset: frozenset({Mode.IDLE, Mode.ESTOPPED}),
        LeaseRequest: frozenset({Mode.ESTOPPED}),
        ButtonRequest: frozenset({Mode.ESTOPPED}),
        Calibrate: frozenset({Mode.ESTOPPED}),
        Kept: frozenset({Mode.ESTOPPED}),
        EmergencyStop: frozenset({Mode.ESTOPPED}),
        BusFailed: frozenset({Mode.BUS_FAULT}),
        StoppedOutside: frozenset({Mode.ESTOPPED}),
        TimePassed: frozenset({Mode.ESTOPPED}),
        ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.BUS_FAULT: {
        Command: frozenset({Mode.BUS_FAULT}),
        Reset: frozenset({Mode.BUS_FAULT}),
        LeaseRequest: frozenset({Mode.BUS_FAULT}),
        ButtonRequest: frozenset({Mode.BUS_FAULT}),
        Calibrate: frozenset({Mode.BUS_FAULT}),
        Kept: frozenset({Mode.BUS_FAULT}),
        EmergencyStop: frozenset({Mode.BUS_FAULT}),
        BusOpened: frozenset({Mode.IDLE, Mode.ESTOPPED}),
        BusFailed: frozenset({Mode.BUS_FAULT}),
        StoppedOutside: frozenset({Mode.BUS_FAULT}),
        TimePassed: frozenset({Mode.BUS_FAULT}),
        ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.STOPPING: {event: frozenset({Mode.STOPPING}) for event in get_args(Event)},
}
"""In which mode which event may come, and which modes it may lead to. Any other event is a mistake of the caller."""


class IllegalEvent(RuntimeError):  # noqa: N818  (h11 and friends: it names what happened)
    """The caller sent an event that has no place in this mode; the state is as it was."""
