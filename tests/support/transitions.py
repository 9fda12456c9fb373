"""In which mode which event may come to the supervisor, and which modes it may lead to.

Written down apart from the code that decides, so that tests compare the two.
"""

from collections.abc import Mapping
from typing import Final, get_args

from gateway.robot.core import events
from schemas.words import Mode

_QUIET: Final = frozenset({Mode.IDLE, Mode.ACTIVE})
_FAULT: Final = frozenset({Mode.BUS_FAULT})
_LEFT_OR_NOT: Final = frozenset({Mode.IDLE, Mode.ESTOPPED})
_TAKEN: Final = (
    events.Command,
    events.Reset,
    events.LeaseRequest,
    events.ButtonRequest,
    events.Calibrate,
    events.CalibrationSaved,
    events.StoppedOutside,
    events.BodyMeasured,
    events.PowerSeen,
    events.TimePassed,
)


def _opened(
    stays: frozenset[Mode], more: Mapping[type[events.Event], frozenset[Mode]], estopped: Mode = Mode.ESTOPPED
) -> dict[type[events.Event], frozenset[Mode]]:
    """Return a mode of a bus that was opened once: what is taken leads to `stays`, except for `more`."""
    ends: dict[type[events.Event], frozenset[Mode]] = {
        events.EmergencyStop: frozenset({estopped}),
        events.BusFailed: _FAULT,
        events.ShutDown: frozenset({Mode.STOPPING}),
    }
    return {**dict.fromkeys(_TAKEN, stays), **ends, **more}


TRANSITIONS: Final[dict[Mode, dict[type[events.Event], frozenset[Mode]]]] = {
    Mode.STARTING: {
        events.EmergencyStop: frozenset({Mode.STARTING}),
        events.EstopKept: frozenset({Mode.STARTING}),
        events.BusOpened: _LEFT_OR_NOT,
        events.BusFailed: _FAULT,
        events.BodyMeasured: frozenset({Mode.STARTING}),
        events.PowerSeen: frozenset({Mode.STARTING}),
        events.TimePassed: frozenset({Mode.STARTING}),
        events.ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.IDLE: _opened(_QUIET, {}),
    Mode.ACTIVE: _opened(_QUIET, {}),
    Mode.ESTOPPED: _opened(frozenset({Mode.ESTOPPED}), dict.fromkeys((events.Reset, events.EstopKept), _LEFT_OR_NOT)),
    Mode.BUS_FAULT: _opened(
        _FAULT, {events.BusOpened: _LEFT_OR_NOT, events.EstopKept: _FAULT}, estopped=Mode.BUS_FAULT
    ),
    Mode.STOPPING: {event: frozenset({Mode.STOPPING}) for event in get_args(events.Event)},
}
"""In which mode which event may come, and which modes it may lead to. Any other event is a mistake of the caller."""
