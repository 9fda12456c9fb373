"""Makes errors that state why legs were stopped or commands are not accepted: who, what, and how it ends. Pure."""

import time
from collections.abc import Callable, Collection, Iterable
from typing import Final, NamedTuple

from gateway.errors import GatewayError, LeaseLostError, RejectedError, StoppedError
from gateway.model.protocols import called
from gateway.words.text import legs_named
from schemas.event import Event
from schemas.gateway_state import GatewayState
from schemas.words import Cause, Kind, Mode, Reason

STOP: Final = "stop"
"""The cause of a StoppedError if somebody sent a Stop."""
AGAIN: Final = "call start_again() when the cause is over"
"""A program's next call, as a note of a stream's or a walk's error. Tracebacks show a note, `str()` does not."""
DECIDES: Final = "nothing starts these legs until the program calls start_again(): a person decides when"
"""The note of an error whose cause does not end by itself."""
_PASSING: Final = (
    Kind.WATCHDOG_EXPIRED, Kind.OVERFLOW, Kind.ESTOP_ENGAGED, Kind.BUS_FAULT, Kind.CONTROLLER_SILENT,
    Kind.CONTROLLER_RESTARTED, Kind.STOPPING, Kind.STARTED, Reason.ESTOPPED, Reason.NOT_HOLDER, Reason.LEASE_HELD,
    Reason.NO_BUTTON, Reason.NO_POWER, Reason.LANDING, Reason.STALE, Kind.LEASE_TAKEN,
)  # fmt: skip
"""Causes that end without this program. A fall and the board's button are none: somebody may touch the robot."""


def passes(error: GatewayError) -> bool:
    """Return whether an error's cause ends without this program. Only then the program may continue by itself."""
    if isinstance(error, StoppedError):
        return error.cause in _PASSING
    if isinstance(error, RejectedError):
        return not isinstance(error, LeaseLostError) and error.reason in _PASSING
    return True


class ReceivedEvent(NamedTuple):
    """An event, and when it was received (monotonic)."""

    event: Event
    received_s: float


def tells(event: Event) -> bool:
    """Return whether an event states why legs stop. `legs_stopped` does for a command; for the rest, another does."""
    return event.kind != Kind.LEGS_STOPPED or (event.cause == Cause.COMMAND and event.source is not None)


def sender(who: str | None, own_name: str, *, own: bool) -> str:
    """Return who sent a command, for people. `own`: this program did; another one may have its name."""
    if own:
        return f"{who} (this program)"
    if not who:
        return "the gateway, or somebody without a name,"
    return f"another program named {who!r}" if who == own_name else who


def stopped_by(who: str | None, name: str, legs: Collection[int], at_s: float | None = None) -> StoppedError:
    """Return the error for a Stop by source `who`, here called `name`. `at_s` is when, if known."""
    return StoppedError(f"{name} stopped {legs_named(legs)}", legs, who, STOP, at_s)


def expired(legs: Collection[int], timeout_ms: float, at_s: float | None = None) -> StoppedError:
    """Return the error for legs that the watchdog has stopped."""
    sentence = f"the watchdog stopped {legs_named(legs)} (no command in {timeout_ms:g} ms)"
    return StoppedError(sentence, legs, None, Kind.WATCHDOG_EXPIRED, at_s)


def reported(
    stops: Iterable[ReceivedEvent], started: frozenset[int], timeout_ms: float, name_of: Callable[[Event], str]
) -> StoppedError:
    """Return the error for all events that stopped a stream's legs (`started`), each cause once.

    `name_of` returns the sender of an event, for people.
    """
    causes: dict[tuple[str, str | None], list[ReceivedEvent]] = {}
    for each in stops:
        causes.setdefault((each.event.kind, each.event.source), []).append(each)
    errors = []
    for (kind, who), found in causes.items():
        if kind == Kind.LEGS_STOPPED and any(other != kind for other, source in causes if source == who):
            continue  # the other event states the reason
        event, at_s = found[-1]
        legs = frozenset[int]().union(*(started.intersection(each.event.legs) or started for each in found))
        if kind == Kind.WATCHDOG_EXPIRED:
            errors.append(expired(legs, timeout_ms, at_s))
        elif kind == Kind.LEGS_STOPPED:
            errors.append(stopped_by(who, name_of(event), legs, at_s))
        else:
            errors.append(StoppedError(happened(event), legs, who, kind, at_s))
    chief = next((each for each in errors if not passes(each)), errors[0])
    legs = frozenset[int]().union(*(each.legs for each in errors))
    return StoppedError("; ".join(each.lasting for each in errors), legs, chief.by, chief.cause, errors[-1].at_s)


def happened(event: Event) -> str:
    """Return the sentence of an event that stopped legs, in past tense, since an error may stay on a screen."""
    if event.kind == Kind.ESTOP_ENGAGED:
        return _engaged(event.source)
    continues = event.kind in (Kind.STOPPED_OUTSIDE, Kind.STOPPING)  # with the state that followed
    return event.detail.partition("; ")[0] if continues else event.detail


def unready(state: GatewayState, legs: Collection[int] = (), reset: str = "") -> StoppedError | None:
    """Return why the gateway accepts no commands in this state, as an error about `legs`, or None.

    `reset`: the command by which a person ends an emergency stop, if it is to be named.
    """
    match state.mode:
        case Mode.IDLE | Mode.ACTIVE:
            return None
        case Mode.ESTOPPED:
            since, by = state.estop_since, state.estop_source
            at_s = None if since is None else time.monotonic() - (state.time - since).total_seconds()
            waits = f"emergency stop: nothing moves until a person runs `{reset}`; " if reset else ""
            return StoppedError(waits + _engaged(by), legs, by, Kind.ESTOP_ENGAGED, at_s)
        case Mode.BUS_FAULT if state.controller.alive is False:
            return StoppedError("the controller fell silent", legs, None, Kind.CONTROLLER_SILENT)
        case Mode.BUS_FAULT:
            return StoppedError(f"{called(state.wire.name)} did not answer", legs, None, Kind.BUS_FAULT)
        case _:
            return StoppedError("the gateway ended, or was started anew", legs, None, Kind.STOPPING)


def not_free(state: GatewayState) -> RejectedError | None:
    """Return why a program without a lease cannot start legs although the gateway accepts commands, or None."""
    if state.lease.holder is not None:
        return RejectedError(Reason.NOT_HOLDER, f"{state.lease.holder} holds the lease")
    if state.buttons.alive < state.buttons.required:
        return RejectedError(Reason.NO_BUTTON, f"{state.buttons.alive} of {state.buttons.required} stop buttons live")
    return None


def _engaged(who: str | None) -> str:
    return f"the emergency stop was engaged by {who or 'somebody'}"
