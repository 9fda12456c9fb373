"""A gait's setpoints at a steady rate, and an error for everything that ends them.

Only the gateway's answers decide. Published reports (a rejection, a state in which a leg does not run) and silence only
raise a doubt, after which the gateway is asked. Events that are newer than the start decide without a query.
"""

import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from types import TracebackType
from typing import Any, Final, Protocol, Self

import zenoh

from gateway.errors import DisconnectedError, GatewayError, LeaseLostError, RejectedError, StoppedError, ZenohError
from gateway.people.client.lease import CONFIRM_S, NOT_OURS, Lease, LeaseClient
from gateway.people.client.pace import LIKE_RADIANS, Doubt, Radians, SetpointPace, thins
from gateway.people.client.payloads import Angle, LegAngles, legs_angles, legs_payload, setpoints
from schemas import keys
from schemas.telemetry import Ack, Event, GatewayState, Kind, Mode, Reason, WatchdogState

MAX_HZ: Final = 1000
"""The highest `limits.leg_rate_hz`."""
_KEPT: Final = 64
_STOPPED_ALREADY: Final = (Reason.ESTOPPED, Reason.STOPPING)
ALL_STOPPED: Final = (
    Kind.ESTOP_ENGAGED,
    Kind.BUS_FAULT,
    Kind.CONTROLLER_SILENT,
    Kind.CONTROLLER_RESTARTED,
    Kind.FALLEN,
    Kind.OFF_BUTTON,
    Kind.STOPPED_OUTSIDE,
    Kind.STOPPING,
)
"""Events of a gateway that has stopped all legs."""
_ENDINGS: Final = (*ALL_STOPPED, Kind.STARTED)
"""Events after which no leg runs."""
_STOPPED_LEGS: Final = (Kind.WATCHDOG_EXPIRED, Kind.OVERFLOW)
"""Events of single legs that the gateway stopped by a rule of its own."""
_EVENT_S: Final = 0.1
"""How much later than an answer the event about the same Stop may arrive."""
AGAIN: Final = "start_again() goes on; after an emergency stop, once reset() has left it"
"""A program's next call, as a note of the error: tracebacks show it, `str()` does not."""
WHOLE: Final = "the first set() has to name all six legs: this robot's controller starts and stops all of them at once"
"""What to send in place of a start that this robot's controller does not know, as a note."""
_AND_THEN: Final = (Kind.WATCHDOG_EXPIRED, Kind.STOPPED_OUTSIDE, Kind.STOPPING)
"""Events whose detail continues, after a semicolon, with the state that followed."""
_SILENCE: Final = "if it runs, its watchdog stops the legs; if it has died, stop-servos does, where systemd runs it"


class StreamClient(LeaseClient, Protocol):
    """What a stream needs of its client."""

    @property
    def connected(self) -> bool: ...

    def check_open(self) -> None: ...

    def ask(self, key: str, payload: Mapping[str, Any], *, again: bool = False) -> Ack: ...

    def publish(self, key: str, payload: Mapping[str, Any]) -> None: ...

    def state(self, timeout_s: float | None = None) -> GatewayState: ...

    def on_state(self, callback: Callable[[GatewayState], None]) -> "zenoh.Subscriber[None]": ...


class Stream:
    """Setpoints for any of the six legs, `hz` times a second; made by `Client.stream`, used in a `with`.

    The first setpoint of a leg starts it. The end of the `with` stops, also after an error, the legs whose start was
    accepted or not answered. It does not stop a leg whose start was rejected, or that the gateway has since reported
    stopped: somebody else may have started it.
    Only `set` sends setpoints, so the gateway's watchdog stops the legs of a program that stalls, and a leg that is
    left out for longer than its timeout. Inside `Client.lease`, legs whose lease was handed over or taken are no longer
    this stream's: it does not stop them at its end. A robot that starts as a whole wants all six legs in each `set`:
    the first starts them together, and a leg that is left out stops them all. For one thread at a time.

    >>> with Client(endpoint) as robot, robot.stream(hz=50) as stream:
    ...     for step in range(10):
    ...         stream.set({1: (90, 45 + step, 120), 2: (90, 45 - step, 120)})
    ...     running = [leg.leg for leg in robot.state().legs if leg.servos[0].running]
    >>> running
    [1, 2]
    """

    def __init__(self, client: StreamClient, hz: float) -> None:
        """Raises ValueError unless 0 < hz ≤ 1000. @private"""
        self._client = client
        self._hz = checked_hz(hz)
        self._pace = SetpointPace(hz)
        self._radians = Radians()
        self._started: frozenset[int] = frozenset()
        self._to_stop: frozenset[int] = frozenset()
        self._lease: Lease | None = None  # under which it started them
        self._since: datetime | None = None  # by the gateway's clock: since then all started legs run
        self._over: GatewayError | None = None
        self._doubt = Doubt(0.0)
        self._events: deque[Event] = deque(maxlen=_KEPT)
        self._received_stop = threading.Event()
        self.answer: GatewayState | None = None
        """The gateway's newest answer; the reader sets it to None."""
        self._rival: str | None = None  # the gateway's sentence about another source that moved a leg of ours
        self._warned = False  # once is enough
        self._subscribers: list[Any] = []
        self._sending = threading.Lock()
        self._open = False

    @property
    def missed(self) -> int:
        """Ticks for which `set` was called too late, or not at all. They were skipped, never sent later."""
        return self._pace.missed

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except GatewayError as failed:
            if error is None:
                raise
            error.add_note(f"and the Stop at the end of the stream: {failed}")

    def set(self, angles_deg: Mapping[int, Sequence[Angle]]) -> None:
        """Wait for the next tick, then send these legs' angles (degrees, 0 to 180, joints 1, 2, 3) in one message.

        The first setpoint of a leg starts it and is acknowledged; the others are fire and forget, so a later call
        raises the error of an earlier one. A servo that another source commanded before, or that was stopped
        within 2 s, goes to its setpoints at no more than `limits.takeover_deg_s` until it has arrived.
        If `limits.start_stagger_ms` spreads starts over more than the watchdog's timeout, add one leg with each call.
        Raises, without sending:

        - LeaseLostError: somebody else drives now.
        - RejectedError: the gateway rejected an earlier setpoint, or this start (nothing more is then sent).
        - StoppedError: the watchdog (this program stalled, or left a leg out), another's Stop, an emergency stop, a bus
          fault or the gateway's end has stopped legs of this stream.
        - DisconnectedError: the link is lost, or the gateway does not answer.
        - ValueError, TypeError: a leg, or its angles, are invalid.

        After LeaseLostError, StoppedError, DisconnectedError and a rejected start each call raises the same again,
        until `start_again`.
        """
        angles = self.read(angles_deg)
        self.check_open()
        due_s = self.due_s()
        while (pause_s := due_s - time.monotonic()) > 0:
            time.sleep(pause_s)
        self.send(angles)

    def start_again(self) -> None:
        """Go on after an error: the next `set` starts its legs anew, from wherever they are."""
        self._over = None
        self._started = frozenset()
        self._pace.pause()

    def go_on_without(self, legs: Iterable[int]) -> None:
        """Go on after a StoppedError with the legs that still run. They are set, never started: no Stop is undone."""
        self._over = None
        self._started -= frozenset(legs)

    # ---- the parts of `with` and of `set`

    def open(self) -> None:
        """Subscribe. Raises DisconnectedError, and ValueError for a rate below the watchdog's. @private

        Warns if the gateway takes fewer setpoints.
        """
        client = self._client
        state = client.state()
        watchdog_s = state.watchdog.timeout_ms / 1000
        if self._pace.period_s >= watchdog_s:
            raise ValueError(f"at {self._hz:g} Hz the watchdog stops each leg after {watchdog_s:g} s of silence")
        if (thinned := thins(self._hz, state.limits.leg_rate_hz)) is not None:
            warnings.warn(thinned, stacklevel=3)
        self._doubt = Doubt(watchdog_s)
        self._subscribers = [client.on_state(self._receive_state), client.on_event(self._receive_event)]
        self._open = True

    def close(self) -> None:
        """Stop the started legs, acknowledged. Raises DisconnectedError, RejectedError. @private"""
        self._open = False
        if not self._sending.acquire(blocking=False):
            # Another thread may be starting legs: a Stop now, and one more after that start.
            self._stop()
            self._sending.acquire()
        try:
            self._stop()
        finally:
            self._sending.release()
            subscribers, self._subscribers = self._subscribers, []
            with suppress(zenoh.ZError):  # the client is closed
                for each in subscribers:
                    each.undeclare()

    def read(self, angles_deg: Mapping[int, Sequence[Angle]]) -> LegAngles:
        """The angles as numbers. Raises ValueError, TypeError. Warns once if they look like radians. @private"""
        if not angles_deg:
            raise ValueError("no leg is given")
        read = legs_angles(angles_deg)
        for leg, angles in read.items():
            for joint, angle in enumerate(angles, start=1):
                if not 0 <= angle <= 180:
                    raise ValueError(f"leg {leg}, joint {joint}: {angle} is not between 0 and 180 degrees")
        if self._radians.suspected(read.values(), time.monotonic()):
            warnings.warn(LIKE_RADIANS, stacklevel=3)
        if self._rival is not None and not self._warned:
            self._warned = True
            warnings.warn(f"{self._rival}; both may move it, as there is no lease: see Client.lease", stacklevel=3)
        return read

    def check_open(self) -> None:
        """Raise RuntimeError outside the `with`, and the error that has ended the stream. @private"""
        if not self._open:
            raise RuntimeError("a stream is used in a `with`, and is over after it")
        if self._over is not None:
            raise self._over.with_traceback(None)

    @property
    def is_over(self) -> bool:
        """Whether each `set` raises the same error again, until `start_again`."""
        return self._over is not None

    def due_s(self) -> float:
        """When (monotonic) to send the setpoint; to be called once for each. @private"""
        return self._pace.next_s(time.monotonic())

    def send(self, angles: LegAngles) -> None:
        """Check and send, with the errors of `set`. @private"""
        with self._sending:
            self.check_open()
            try:
                if self._started:
                    if self._lease is not None:
                        self._lease.check()
                    self._check()
                if angles.keys() <= self._started:
                    self._publish(angles)
                else:
                    self._start(angles)
            except (StoppedError, RejectedError, DisconnectedError) as error:
                lost = self._lost_lease(error)
                if lost is not None:
                    self._over = lost
                    raise lost from (None if lost is error else error)
                if not isinstance(error, RejectedError):
                    self._over = error
                    error.add_note(AGAIN)
                raise

    def _lost_lease(self, error: GatewayError) -> LeaseLostError | None:
        """The loss of the lease, if it caused the error: a forced take stops all legs and rejects later commands."""
        if isinstance(error, LeaseLostError):
            return error
        may_be = isinstance(error, StoppedError) or (isinstance(error, RejectedError) and error.reason in NOT_OURS)
        return self._lease.confirm() if may_be and self._lease is not None else None

    def _publish(self, angles: LegAngles) -> None:
        self._client.publish(keys.LEGS_COMMAND, {"source": self._client.name, "legs": setpoints("set", angles)})
        self._doubt.sent(time.monotonic())

    def _start(self, angles: LegAngles) -> None:
        new = {leg: each for leg, each in angles.items() if leg not in self._started}
        old = {leg: each for leg, each in angles.items() if leg in self._started}
        legs = setpoints("start", new) | setpoints("set", old)
        before = self._to_stop
        self._to_stop |= new.keys()  # without an answer they may run
        self._lease = self._client.carried_lease
        self._received_stop.clear()
        try:
            ack = self._client.ask(keys.LEGS_COMMAND, {"source": self._client.name, "legs": legs})
        except LeaseLostError:  # so it was rejected
            self._to_stop = before
            raise
        if not ack.accepted:
            self._to_stop = before
            self._over = _rejected(ack)
            raise self._over
        first = not self._started
        sent_s = time.monotonic()
        self._doubt.sent(sent_s)
        self._started |= new.keys()
        self._since = self._ask().time
        if first:
            self._pace.begin(sent_s)

    def _stop(self) -> None:
        if not self._to_stop or (self._lease is not None and self._lease.elsewhere):
            return
        payload = {"source": self._client.name, **legs_payload("stop", dict.fromkeys(sorted(self._to_stop), ()))}
        ack = self._client.ask(keys.LEGS_COMMAND, payload, again=True)
        if not ack.accepted and ack.reason not in _STOPPED_ALREADY:
            raise _rejected(ack)

    # ---- what is received, on a thread of Zenoh's

    def _receive_state(self, state: GatewayState) -> None:
        self._doubt.received(time.monotonic())
        if self._stopped_legs(state):
            self._doubt.raise_it()

    def _receive_event(self, event: Event) -> None:
        self._doubt.received(time.monotonic())
        if event.kind == Kind.COMMAND_REJECTED:
            # A command with a leg that is not ours is another stream's, of the same client.
            named_ours = self._started.issuperset(event.legs)
            if event.source == self._client.name and event.key == keys.LEGS_COMMAND and named_ours:
                self._events.append(event)
        elif event.kind in _STOPPED_LEGS:
            if self._started.intersection(event.legs):
                self._events.append(event)
                self._received_stop.set()
            elif not event.legs:  # an older gateway omits them
                self._doubt.raise_it()
        elif event.kind in _ENDINGS:
            self._events.append(event)
        elif event.kind == Kind.SOURCE_CHANGED and self._takes(event):
            self._rival = event.detail

    def _takes(self, event: Event) -> bool:
        """Whether we took a leg from another source. A leg that a source takes from us it may also stop."""
        ours = event.source == self._client.name and self._lease is None
        return ours and bool(self._to_stop.intersection(event.legs))

    # ---- what follows from it

    def _in_doubt(self) -> bool:
        return self._doubt.is_there(time.monotonic()) or not self._client.connected

    def _check(self) -> None:
        """Raise what has happened since the latest call."""
        fresh = self._fresh_events()
        if (error := self._reported_stop(fresh)) is not None:
            raise error
        if fresh:
            self._ask()  # whose answer states better why legs do not run
            raise RejectedError(fresh[0].reason or "", fresh[0].detail)
        if self._in_doubt():
            self._ask()

    def _fresh_events(self) -> list[Event]:
        """The events since the latest call. Those before the start concern earlier motion."""
        events = []
        while self._events:
            events.append(self._events.popleft())
        return [event for event in events if self._since is not None and event.time > self._since]

    def _reported_stop(self, events: Iterable[Event]) -> StoppedError | None:
        """The error for all events that stopped this stream's legs; None: there are none."""
        stops = [event for event in events if event.kind != Kind.COMMAND_REJECTED]
        if not stops:
            return None
        details = "; ".join(dict.fromkeys(map(happened, stops)))
        legs = [self._started.intersection(event.legs) or self._started for event in stops]
        return StoppedError(details, frozenset().union(*legs))

    def _ask(self) -> GatewayState:
        """Ask for the state. Raises unless all started legs run."""
        self._client.check_open()
        if not self._client.connected:
            raise DisconnectedError(f"the link to the gateway was lost: {_SILENCE}")
        self._doubt.asked()
        try:
            state = self._client.state(CONFIRM_S)
        except ZenohError as error:
            raise DisconnectedError(f"the gateway did not answer: {_SILENCE}") from error
        self._doubt.received(time.monotonic())
        self.answer = state
        self._to_stop -= self._not_ours(state)
        if self._stopped_legs(state):
            raise self._stopped(state)
        return state

    def _not_ours(self, state: GatewayState) -> frozenset[int]:
        """Legs that the end of this stream must not stop; this state is newer than the answers to our starts.

        A leg that does not run is no longer ours: only somebody else can start it again. While somebody else holds the
        lease, a leg with another source is theirs: the takeover has stopped ours.
        """
        ours_only = state.lease.holder is None or (self._lease is not None and self._lease.held)
        return frozenset(
            each.leg
            for each in state.legs
            if not any(servo.running for servo in each.servos) or not (ours_only or each.source == self._client.name)
        )

    def _stopped_legs(self, state: GatewayState) -> frozenset[int]:
        stopped = {each.leg for each in state.legs if not all(servo.running for servo in each.servos)}
        return self._started & stopped

    def _stopped(self, state: GatewayState) -> StoppedError:
        legs = self._stopped_legs(state)
        expired = [each.leg for each in state.legs if each.leg in legs and each.watchdog == WatchdogState.EXPIRED]
        names = ", ".join(f"leg {leg}" for leg in expired or sorted(legs))
        match state.mode:
            case Mode.ESTOPPED:
                why = f"the emergency stop was engaged by {state.estop_source or 'somebody'}"
            case Mode.BUS_FAULT if state.controller.alive is False:
                why = "the controller fell silent"
            case Mode.BUS_FAULT:
                why = "the SPI bus did not answer"
            case Mode.STOPPING | Mode.STARTING:
                why = "the gateway ended, or was started anew"
            case _ if expired:
                why = f"the watchdog stopped {names}: no command in {state.watchdog.timeout_ms:g} ms"
            case _ if any(each.source is not None for each in state.legs if each.leg in legs):
                why = f"somebody else stopped {names}"
            case _:
                self._received_stop.wait(_EVENT_S)
                if (error := self._reported_stop(self._fresh_events())) is not None:
                    return error
                why = f"the gateway stopped {names} by itself (its events say why), or a Stop without a name did"
        return StoppedError(why, legs)


def happened(event: Event) -> str:
    """The sentence of an event that stopped legs, in past tense: an error may be shown for long."""
    if event.kind == Kind.ESTOP_ENGAGED:
        return f"the emergency stop was engaged by {event.source or 'somebody'}"
    return event.detail.partition("; ")[0] if event.kind in _AND_THEN else event.detail


def checked_hz(hz: float) -> float:
    """Raises ValueError unless 0 < hz ≤ 1000."""
    if not 0 < hz <= MAX_HZ:
        raise ValueError(f"{hz:g} Hz; a stream's rate is above 0 and at most {MAX_HZ}")
    return hz


def _rejected(ack: Ack) -> RejectedError:
    error = RejectedError(ack.reason or "", ack.detail or "")
    if error.reason == Reason.WHOLE_ROBOT:
        error.add_note(WHOLE)
    return error
