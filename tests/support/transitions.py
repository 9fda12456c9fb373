"""In which mode which event may come to the supervisor, and which modes it may lead to; the same of the lease.

Written down apart from the code that decides, so that tests compare the two.
"""

from typing import Final, get_args

from gateway.robot.core.events import (
    BusFailed,
    BusOpened,
    ButtonRequest,
    Calibrate,
    Command,
    Do,
    EmergencyStop,
    Event,
    Kept,
    LeaseRequest,
    Reset,
    ShutDown,
    StoppedOutside,
    TimePassed,
)
from gateway.robot.core.lease import LeaseState
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

_FREE, _HELD, _ASKED, _HANDED_OVER = LeaseState

LEASE_TRANSITIONS: Final[dict[LeaseState, dict[Do, frozenset[LeaseState]]]] = {
    _FREE: {
        Do.ACQUIRE: frozenset({_HELD}),
        Do.ASK: frozenset({_FREE}),
        Do.TAKE: frozenset({_HELD}),
        Do.RENEW: frozenset({_FREE}),
        Do.RELEASE: frozenset({_FREE}),
    },
    _HELD: {
        Do.ACQUIRE: frozenset({_HELD}),
        Do.ASK: frozenset({_ASKED}),
        Do.TAKE: frozenset({_HELD}),
        Do.RENEW: frozenset({_HELD}),
        Do.RELEASE: frozenset({_HELD, _FREE}),
    },
    _ASKED: {
        Do.ACQUIRE: frozenset({_ASKED}),
        Do.ASK: frozenset({_ASKED}),
        Do.TAKE: frozenset({_ASKED, _HELD}),
        Do.RENEW: frozenset({_ASKED}),
        Do.RELEASE: frozenset({_ASKED, _FREE, _HANDED_OVER}),
    },
    _HANDED_OVER: {
        Do.ACQUIRE: frozenset({_HANDED_OVER, _HELD}),
        Do.ASK: frozenset({_HANDED_OVER}),
        Do.TAKE: frozenset({_HANDED_OVER, _HELD}),
        Do.RENEW: frozenset({_HANDED_OVER}),
        Do.RELEASE: frozenset({_HANDED_OVER}),
    },
}
"""Where each request leads; where it may also leave the lease as it is, it may be rejected. Time leads to FREE."""
