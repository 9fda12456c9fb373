"""The lease, the buttons, the body, the power board and the calibration in the model check: what may be asked
of them, how they are copied, and what of them tells states apart."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from gateway.allowance import NS_PER_MS
from gateway.model.calibration import RobotCalibration
from gateway.robot.core import events
from gateway.robot.core.buttons import Buttons
from gateway.robot.core.interlock import Interlock
from gateway.robot.core.lease import RobotLease
from gateway.robot.core.leg import Servo
from gateway.robot.core.legs import Legs
from gateway.robot.core.rest import RestStops
from gateway.robot.core.supervisor import Supervisor
from schemas.calibration import CalibrationCommand
from tests.support.backlog_history import backlog_key
from tests.support.buttons_history import ButtonsHistory
from tests.support.calibration_history import CalibrationHistory
from tests.support.history import cloned
from tests.support.lease_history import LeaseHistory


def copied_interlocks(supervisor: Supervisor) -> Iterator[Interlock[Any]]:
    """Copies that share nothing that changes."""
    for each in supervisor._interlocks:
        if isinstance(each, RobotLease):
            yield cloned(each, _askers=dict(each._askers))
        elif isinstance(each, Buttons):
            yield cloned(each, _by_token={token: replace(button) for token, button in each._by_token.items()})
        else:
            yield cloned(each)


# ---- the lease


def lease_key(lease: RobotLease, now_ns: int) -> tuple[object, ...]:
    """What of it can still matter; one token is as good as another."""
    left_ns = None if lease.due_ns is None else lease.due_ns - now_ns
    return lease.holder, lease._token is not None, left_ns, lease.closed, tuple(lease._askers)


def tokens(drivers: Sequence[str], lease: LeaseHistory) -> Iterator[tuple[str, str | None]]:
    """What a command may carry: no token, that of the lease, or that of a lease that has ended."""
    yield "", None
    if drivers and lease.token is not None:
        yield " of the holder", lease.token
    if drivers and lease.old_token is not None:
        yield " of a former holder", lease.old_token


def lease_requests(drivers: Sequence[str], number: int, lease: LeaseHistory) -> Iterator[tuple[str, events.Event]]:
    """Everything that each of them may want of it; a new token is one that nobody had."""
    fresh = f"token {number}"
    for name in drivers:
        for do in ("acquire", "ask", "take"):
            yield f"{name} wants to {do}", events.LeaseRequest(do, name, fresh_token=fresh)
    for whose, token in tokens(drivers, lease):
        if token is not None:
            yield f"renewal{whose}", events.LeaseRequest("renew", token=token)
            yield f"release{whose}", events.LeaseRequest("release", token=token)
            yield f"handover{whose}", events.LeaseRequest("release", token=token, to=drivers[-1])


# ---- the buttons


def buttons_key(buttons: Buttons, now_ns: int) -> tuple[object, ...]:
    """What of them can still matter; one token, and one count, is as good as another."""
    each = tuple(
        (button.name, button.until_ns and button.until_ns - now_ns, button.silent, button.offset_ns, button.least_ns)
        for button in buttons._by_token.values()
    )
    return each, buttons.closed, buttons.due_ns and buttons.due_ns - now_ns


def button_requests(
    names: Sequence[str], number: int, now_ns: int, delays_ns: Sequence[int], buttons: ButtonsHistory
) -> Iterator[tuple[str, events.Event]]:
    """Everything that each of them may want `now`; a new token is one that nobody had.

    A check-in is the next one, or the latest one again; it says when it was sent (so long ago), or does not.
    """
    for name in names:
        register = events.ButtonRequest("register", now_ns, name, fresh_token=f"token {number}")
        yield f"{name} registers", register
        for delay_ns in delays_ns:
            yield f"{name} registers, {delay_ns} late", replace(register, sent_ms=(now_ns - delay_ns) / NS_PER_MS)
    tokens = [*buttons.known, *([] if buttons.old_token is None else [buttons.old_token])]
    for token in tokens if names else ():
        whose = buttons.known[token].name if token in buttons.known else "a former button"
        count = buttons.known[token].count if token in buttons.known else number
        alive = events.ButtonRequest("alive", now_ns, token=token, count=count + 1)
        yield f"{whose} is alive", alive
        yield f"a check-in of {whose} once more", replace(alive, count=count)
        for delay_ns in delays_ns:
            yield f"{whose} was alive {delay_ns} ago", replace(alive, sent_ms=(now_ns - delay_ns) / NS_PER_MS)
        yield f"{whose} leaves", events.ButtonRequest("leave", now_ns, token=token)


# ---- the body


def body_key(supervisor: Supervisor, now_ns: int) -> tuple[object, ...]:
    """What of its measurements can still matter."""
    body, tilt_ns = supervisor.body, supervisor._rules.tilt_ns
    age_ns = None if body.beyond_ns is None else now_ns - body.beyond_ns
    landing_ns = supervisor._rules.landing_ns
    return body.low, body.fallen, age_ns if age_ns is None else min(age_ns, tilt_ns + landing_ns)


def measurements(bodies: Sequence[tuple[int | None, int]]) -> Iterator[tuple[str, events.Event]]:
    """What the robot may measure: each tilt with each voltage that it has."""
    for tilt_cdeg, battery_mv in bodies:
        yield f"tilt {tilt_cdeg}, battery {battery_mv}", events.BodyMeasured(tilt_cdeg, battery_mv)


def rest_key(rest: RestStops, now_ns: int) -> tuple[object, ...]:
    """When the next Stops to legs at rest come, and how many runs are left, from when on."""
    due_ns = None if rest.due_ns is None else max(0, rest.due_ns - now_ns)
    return due_ns, rest._runs_left, rest._runs_left and max(0, rest._settled_ns - now_ns)


def power_key(supervisor: Supervisor) -> tuple[object, ...]:
    """What the power board has said, as far as it can still matter."""
    power = supervisor.power
    return power.alive, power.closed, tuple(power._refused)


def takeover_key(legs: Legs, servo: Servo, now_ns: int) -> tuple[object, ...]:
    """Whose servo it is, and where it stands while it does not run, as long as that counts."""
    stood = None
    if servo.stopped is not None and not servo.running:
        angle_cdeg, stopped_ns, calibration = servo.stopped
        if calibration is legs._limits.calibration and now_ns - stopped_ns <= legs._rules.takeover_known_ns:
            stood = angle_cdeg, now_ns - stopped_ns
    return servo.source, servo.eases, stood


# ---- the calibration


def share_limits(supervisor: Supervisor, other: Supervisor) -> None:
    """Give `other` angle limits of its own, those of `supervisor`; to be called once it has its own interlocks."""
    other._limits = other.legs._limits = other.calibrating._limits = cloned(supervisor._limits)
    other.legs._speeds = cloned(supervisor.legs._speeds, _limits=other._limits)


def _key(calibration: RobotCalibration) -> tuple[object, ...]:
    """One revision is as good as another."""
    return tuple(sorted(calibration.servos.items())), tuple(sorted(calibration.landing_cdeg.items()))


def calibrating_key(supervisor: Supervisor) -> tuple[object, ...]:
    """What of it can still matter."""
    calibrating, limits = supervisor.calibrating, supervisor._limits
    way = calibrating._on_its_way
    return (
        _key(limits.calibration),
        limits.wire is not None,
        limits.limited,
        calibrating.fault,
        calibrating.closed,
        way and (_key(way.calibration), way.servos, way.event.accept_default),
    )


def changes(
    wanted: Sequence[CalibrationCommand], number: int, history: CalibrationHistory
) -> Iterator[tuple[str, events.Event]]:
    """Everything that may be asked of the calibration, and what the disk may answer."""
    revision = history.whole.revision
    for which, change in enumerate(wanted):
        yield (
            f"calibration {which}",
            events.Calibrate(number=number, change=change, revision=revision, accept_default=not history.trusted),
        )
    if wanted:
        yield "calibration of an older one", events.Calibrate(number=number, change=wanted[0], revision=revision - 1)
        yield (
            "another default accepted",
            events.Calibrate(
                number=number, change=CalibrationCommand(servos={}, landing={}), accept_default=history.trusted
            ),
        )
    if history.on_its_way is not None:
        yield "calibration kept", events.CalibrationSaved(history.on_its_way.number)
        yield "calibration not kept", events.CalibrationSaved(history.on_its_way.number, "the disk is full")


def copy_backlog(supervisor: Supervisor, other: Supervisor) -> None:
    """Give a copy its own messages without a time."""
    backlog = supervisor.backlog
    came_ns, until_ns = dict(backlog._came_ns), dict(backlog._until_ns)
    other.backlog = cloned(backlog, _legs=other.legs, _came_ns=came_ns, _until_ns=until_ns, held=dict(backlog.held))


def core_backlog_key(supervisor: Supervisor, now_ns: int) -> tuple[object, ...]:
    """What of them still matters."""
    backlog = supervisor.backlog
    waiting = [leg.number for leg in supervisor.legs if leg.armed and not any(servo.running for servo in leg.servos)]
    return backlog_key(backlog._rules, backlog._came_ns, backlog._until_ns, backlog.held, now_ns, waiting)
