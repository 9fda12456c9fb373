"""The calibration in the model check: what may be asked of it, how it is copied, and what of it tells states apart."""

from collections.abc import Iterator, Sequence

from gateway.robot.core.calibration import Calibration, Change
from gateway.robot.core.events import Calibrate, Event, Kept
from gateway.robot.core.supervisor import Supervisor
from tests.support.calibration_history import CalibrationHistory
from tests.support.history import cloned


def copy_calibrating(supervisor: Supervisor, other: Supervisor) -> None:
    """Give `other` a calibration of its own, that of `supervisor`; to be called once it has its own legs."""
    other._reach = other.legs._reach = cloned(supervisor._reach)
    other.calibrating = cloned(supervisor.calibrating, _reach=other._reach)


def _key(calibration: Calibration) -> tuple[object, ...]:
    """One revision is as good as another."""
    return tuple(sorted(calibration.servos.items())), tuple(sorted(calibration.landing_cdeg.items()))


def calibrating_key(supervisor: Supervisor) -> tuple[object, ...]:
    """What of it can still matter."""
    calibrating, reach = supervisor.calibrating, supervisor._reach
    way = calibrating._on_its_way
    return (
        _key(reach.calibration),
        reach.wire is not None,
        reach.limited,
        calibrating.fault,
        calibrating.guards,
        way and (_key(way.calibration), way.servos, way.event.accept_default),
    )


def changes(wanted: Sequence[Change], number: int, history: CalibrationHistory) -> Iterator[tuple[str, Event]]:
    """Everything that may be asked of the calibration, and what the disk may answer."""
    revision = history.whole.revision
    for which, change in enumerate(wanted):
        yield f"calibration {which}", Calibrate(number, change, revision, accept_default=not history.trusted)
    if wanted:
        yield "calibration of an older one", Calibrate(number, wanted[0], revision - 1)
        yield "another default accepted", Calibrate(number, Change({}, {}), accept_default=history.trusted)
    if history.on_its_way is not None:
        yield "calibration kept", Kept(history.on_its_way.number)
        yield "calibration not kept", Kept(history.on_its_way.number, "the disk is full")
