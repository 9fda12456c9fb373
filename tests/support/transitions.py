"""In which mode which event may come to the supervisor, and which modes it may lead to.

Written down apart from the code that decides, so that tests compare the two.
"""

from collections.abc import Mapping
from typing import Final, get_args

from gateway.robot.core.events import (
    BodyMeasured,
    BusFailed,
    BusOpened,
    ButtonRequest,
    Calibrate,
    CalibrationSaved,
    Command,
    EmergencyStop,
    EstopKept,
    Event,
    LeaseRequest,
    PowerSeen,
    Reset,
    ShutDown,
    StoppedOutside,
    TimePassed,
)
from schemas.telemetry import Mode

_QUIET: Final = frozenset({Mode.IDLE, Mode.ACTIVE})
_FAULT: Final = frozenset({Mode.BUS_FAULT})
_LEFT_OR_NOT: Final = frozenset({Mode.IDLE, Mode.ESTOPPED})
_TAKEN: Final = (
    Command,
    Reset,
    LeaseRequest,
    ButtonRequest,
    Calibrate,
    CalibrationSaved,
    StoppedOutside,
    BodyMeasured,
    PowerSeen,
    TimePassed,
)


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
        EstopKept: frozenset({Mode.STARTING}),
        BusOpened: _LEFT_OR_NOT,
        BusFailed: _FAULT,
        BodyMeasured: frozenset({Mode.STARTING}),
        PowerSeen: frozenset({Mode.STARTING}),
        TimePassed: frozenset({Mode.STARTING}),
        ShutDown: frozenset({Mode.STOPPING}),
    },
    Mode.IDLE: _opened(_QUIET, {}),
    Mode.ACTIVE: _opened(_QUIET, {}),
    Mode.ESTOPPED: _opened(frozenset({Mode.ESTOPPED}), dict.fromkeys((Reset, EstopKept), _LEFT_OR_NOT)),
    Mode.BUS_FAULT: _opened(_FAULT, {BusOpened: _LEFT_OR_NOT, EstopKept: _FAULT}, estopped=Mode.BUS_FAULT),
    Mode.STOPPING: {event: frozenset({Mode.STOPPING}) for event in get_args(Event)},
}
"""In which mode which event may come, and which modes it may lead to. Any other event is a mistake of the caller."""
