"""In which mode which event may come to the supervisor, and which modes it may lead to; the same of the lease.

Written down apart from the code that decides, so that tests compare the two.
"""

from collections.abc import Mapping
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
_FAULT: Final = frozenset({Mode.BUS_FAULT})
_TAKEN: Final = (Command, Reset, LeaseRequest, ButtonRequest, Calibrate, Kept, StoppedOutside, TimePassed)


def _opened(
    stays: frozenset[Mode], more: Mapping[type[Event], frozenset[Mode]], estopped: Mode = Mode.ESTOPPED
) -> dict[type[Event], frozenset[Mode]]:
    """A mode of a bus that was opened once: what is taken leads to `stays`, except for `more`."""
    ends: dict[type[Event], frozenset[Mode]] = {
        EmergencyStop: frozenset({estopped}),
        BusFailed: _FAULT,
        ShutDown: frozenset({Mode.STOPPING}),
    }
    return {**dict.fromkeys(_TAKEN, stays), **ends, **more}


TRANSITIONS: Final[dict[Mode, dict[type[Event], frozenset[Mode]]]] = {
    Mode.STARTING: {
        EmergencyStop: frozenset({Mode.STARTING}),
        BusOpened: frozenset({Mode.IDLE, Mode.ESTOPPED}),
        BusFailed: _FAULT,
        TimePassed: frozenset({Mode.STARTING}),
        ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.IDLE: _opened(_QUIET, {}),
    Mode.ACTIVE: _opened(_QUIET, {}),
    Mode.ESTOPPED: _opened(frozenset({Mode.ESTOPPED}), {Reset: frozenset({Mode.IDLE, Mode.ESTOPPED})}),
    Mode.BUS_FAULT: _opened(_FAULT, {BusOpened: frozenset({Mode.IDLE, Mode.ESTOPPED})}, estopped=Mode.BUS_FAULT),
    Mode.STOPPING: {event: frozenset({Mode.STOPPING}) for event in get_args(Event)},
}
"""In which mode which event may come, and which modes it may lead to. Any other event is a mistake of the caller."""

_FREE, _HELD, _ASKED, _HANDED_OVER = LeaseState

_LEASE: Final = {
    _FREE: ((_HELD,), (_FREE,), (_HELD,), (_FREE,), (_FREE,)),
    _HELD: ((_HELD,), (_ASKED,), (_HELD,), (_HELD,), (_HELD, _FREE)),
    _ASKED: ((_ASKED,), (_ASKED,), (_ASKED, _HELD), (_ASKED,), (_ASKED, _FREE, _HANDED_OVER)),
    _HANDED_OVER: ((_HANDED_OVER, _HELD), (_HANDED_OVER,), (_HANDED_OVER, _HELD), (_HANDED_OVER,), (_HANDED_OVER,)),
}
LEASE_TRANSITIONS: Final[dict[LeaseState, dict[Do, frozenset[LeaseState]]]] = {
    state: {do: frozenset(to) for do, to in zip((Do.ACQUIRE, Do.ASK, Do.TAKE, Do.RENEW, Do.RELEASE), row, strict=True)}
    for state, row in _LEASE.items()
}
"""Where each request leads; where it may also leave the lease as it is, it may be rejected. Time leads to FREE."""
