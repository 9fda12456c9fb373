"""Sends a gait's setpoints at a steady rate, and raises an error for everything that ends them.

Only the gateway's answers decide. Published reports (a rejection, a state in which a leg does not run) and silence only
raise a doubt; then the gateway is asked. Events that are newer than the start decide without a query.
"""

import threading
import time
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from typing import Any, Final, NoReturn, Self

from gateway.errors import (
    DisconnectedError,
    GatewayError,
    LeaseError,
    LeaseLostError,
    RejectedError,
    StoppedError,
    ZenohError,
)
from gateway.people.client import pace, stopped
from gateway.people.client.lease import CONFIRM_S, NOT_OURS, DrivingClient, Lease, own_lease
from gateway.people.client.payloads import LegAngles, Setpoints, Unit, legs_angles, legs_payload, setpoints
from gateway.people.client.stopped import ReceivedEvent
from gateway.people.client.subscriptions import undeclare, weakly
from gateway.words.text import legs_named
from schemas import keys
from schemas.ack import Ack
from schemas.event import Event
from schemas.gateway_state import GatewayState, LegReport
from schemas.words import Kind, Reason, WatchdogState

MAX_HZ: Final = 1000
"""The highest `limits.leg_rate_hz`."""
_KEPT: Final = 64
_STOPPED_ALREADY: Final = (Reason.ESTOPPED, Reason.STOPPING)
_SLOW: Final = 5
"""A start and a question after it are four ways over the link. One that takes longer is fed in between."""
_EVENT_S: Final = 0.1
"""An event may arrive this much later than an answer about the same Stop."""
WHOLE: Final = "the first set() has to name all six legs: this robot's controller starts and stops all of them at once"
"""The note of a rejected start of single legs."""
_SILENCE: Final = "if it runs, its watchdog stops the legs; if it has died, stop-servos does, where systemd runs it"


class Stream:
    """Setpoints for any of the six legs, `hz` times a second; made by `Client.stream`.

    Use it in a `with`, or call `open` and `close`; the end of the client, or of the program, closes it as well.
    It drives under the client's lease, or acquires one with its first start and releases it at its end.
    The first setpoint of a leg starts it. The end of the stream, also after an error, stops the legs whose start was
    accepted or not answered. It leaves a leg whose start was rejected, or that the gateway has since reported stopped:
    somebody else may have started it. It also leaves legs whose lease was handed over or taken.
    Only `set` sends setpoints. The gateway's watchdog stops the legs of a program that stalls, and a leg that is left
    out for longer than its timeout. A robot that starts as a whole needs all six legs in each `set`: the first starts
    them together, and a leg that is left out stops them all. For one thread at a time.

    >>> with Client(endpoint) as robot, robot.stream(hz=50) as stream:
    ...     for step in range(10):
    ...         stream.set({leg: (90, 45 + step, 120) for leg in range(1, 7)})
    ...     running = [leg.leg for leg in robot.state().legs if leg.running]
    >>> running
    [1, 2, 3, 4, 5, 6]
    """

    def __init__(self, client: DrivingClient, hz: float, *, lease: bool = True) -> None:
        """Raises ValueError unless 0 < hz ≤ 1000. @private"""
        self._client = client
        self._wants_lease = lease
        self._own: Lease | None = None
        self._hz = checked_hz(hz)
        self._pace = pace.SetpointPace(hz)
        self._retries = pace.Retries()
        self._started: frozenset[int] = frozenset()
        self._to_stop: frozenset[int] = frozenset()
        self._lease: Lease | None = None  # under which it started them
        self._since: datetime | None = None  # by the gateway's clock: since then all started legs run
        self._sent: LegAngles = {}
        self._over: GatewayError | None = None
        self._doubt = pace.Doubt(0.0)
        self._events: deque[ReceivedEvent] = deque(maxlen=_KEPT)
        self._received_stop = threading.Event()
        self.answer: GatewayState | None = None
        """The gateway's newest answer, until its reader sets this to None."""
        self._rival: str | None = None  # the gateway's sentence about another source that moved a leg of ours
        self._warned = False  # once is enough
        self._subscribers: list[Any] = []
        self._sending = threading.Lock()
        self._open: bool | None = None  # not yet

    @property
    def missed(self) -> int:
        """Ticks for which `set` was called too late, or not called. They were skipped, never sent later."""
        return self._pace.missed

    @property
    def jitter(self) -> pace.Jitter:
        """How late the newest setpoints were sent after their ticks: `p50_ms`, `p99_ms`, `max_ms`."""
        return self._pace.jitter

    def __repr__(self) -> str:
        runs = legs_named(self._started) if self._started else "no leg"
        return f"<Stream {self._hz:g} Hz, {'open' if self._open else 'closed'}, {runs} started, {self.missed} missed>"

    def __enter__(self) -> Self:
        return self.open()

    def __exit__(self, _kind: Any, error: BaseException | None, _trace: Any) -> None:
        with noted(error, "the Stop at the end of the stream"):
            self.close()

    def set(self, angles: Setpoints, *, unit: Unit = "deg") -> None:
        """Wait for the next tick, also before an error, then send the legs' angles in one message.

        `angles`: joints 1, 2, 3 by leg, `{3: (90, 45, 120)}`, or an array of all legs, (6, 3) or (18,). `unit`: `deg`
        (0 to 180) or `rad` (0 to π). The first setpoint of a leg starts it and is acknowledged. The others are not, so
        a later call raises their error. A servo that another source commanded before, or that was stopped within 2 s,
        moves at no more than `limits.takeover_deg_s` until it has arrived. If `limits.start_stagger_ms` spreads starts
        over more than the watchdog's timeout, add one leg with each call. Raises, without sending:

        - LeaseError: somebody else drives; as LeaseLostError: since then.
        - RejectedError: the gateway rejected an earlier setpoint, or this start (nothing more is then sent). As
          OutOfRangeError: a leg or angle does not exist.
        - StoppedError: the watchdog (this program stalled, or left a leg out), another's Stop, an emergency stop, a bus
          fault or the gateway's end has stopped legs of this stream.
        - DisconnectedError: the link is lost, or the gateway does not answer.
        - TypeError: a leg, or an angle, is no number.

        After LeaseLostError, StoppedError, DisconnectedError and a rejected start each call raises the same again,
        until `recover` or `start_again`. Then starts that fail are sent at most twice a second. If only some legs were
        stopped, the others hold: their newest angles are sent once more, so that the program has the watchdog's timeout
        to decide.
        """
        starts = self._over is None and not self._started
        due_s = self._pace.next_s(time.monotonic(), self._retries.next_s if starts else 0.0)
        while (pause_s := due_s - time.monotonic()) > 0:
            time.sleep(pause_s)
        self._pace.sent(time.monotonic())
        self.send(self._read(angles, unit))

    def recover(self, timeout_s: float = 60.0) -> None:
        """Wait until the cause of the error is over; the next `set` starts its legs anew, from wherever they are.

        It waits for the link, the gateway, the bus, a stop button, somebody else's lease, and a person who resets the
        emergency stop. It releases the stream's own lease, since a reset needs it. It asks twice a second. Raises
        the error at once if waiting does not end its cause: a fall, a command that is always rejected, or somebody's
        Stop, which a person undoes by `start_again`. Raises the remaining cause after `timeout_s`. Without an error it
        does nothing.
        """
        error, end_s = self._over, time.monotonic() + timeout_s
        if error is None:
            return
        if not stopped.passes(error):
            raise error.with_traceback(None)
        self._release()  # a reset needs the lease
        while True:
            time.sleep(max(0.0, min(self._retries.next_s, end_s) - time.monotonic()))
            if (cause := self._still()) is None:
                break
            if time.monotonic() >= end_s:
                raise cause from error
            self._retries.asked(time.monotonic())
        self.start_again()

    def start_again(self) -> None:
        """Go on after an error: the next `set` starts its legs anew, from wherever they are."""
        self._over = None
        self._started = frozenset()
        self._pace.pause()

    def go_on_without(self, legs: Iterable[int]) -> None:
        """Go on after a StoppedError without `legs`. The others are set, never started: no Stop is undone."""
        self._over = None
        self._started -= frozenset(legs)
        self._doubt.asked()  # the reports until now were about these legs

    def open(self) -> Self:
        """Begin without moving a leg. Warns if the gateway takes fewer setpoints a second.

        Raises DisconnectedError without a gateway, ValueError if a period is as long as the watchdog's timeout.
        """
        client = self._client
        state = client.state()
        watchdog_s = state.watchdog.timeout_ms / 1000
        if self._pace.period_s >= watchdog_s:
            raise ValueError(f"at {self._hz:g} Hz the watchdog stops each leg after {watchdog_s:g} s of silence")
        if (thinned := pace.thins(self._hz, state.limits.leg_rate_hz)) is not None:
            warnings.warn(thinned, stacklevel=3)
        self._doubt = pace.Doubt(watchdog_s)
        self._subscribers = [client.on_state(weakly(self._receive_state)), client.on_event(weakly(self._receive_event))]
        self._open = True
        client.open_parts[self] = None
        return self

    def close(self) -> None:
        """Stop the started legs. Raises DisconnectedError without an answer, RejectedError if a Stop is rejected."""
        self._open = False
        self._client.open_parts.pop(self, None)
        if not self._sending.acquire(blocking=False):
            # Another thread may be starting legs: a Stop now, and one more after that start.
            self._stop()
            self._sending.acquire()
        try:
            self._stop()
        finally:
            self._sending.release()
            self._release()
            undeclare(self._subscribers)

    @property
    def is_over(self) -> bool:
        """Whether each `set` raises the same error again, until `recover` or `start_again`."""
        return self._over is not None

    # ---- the parts of `set`

    def _read(self, angles: Setpoints, unit: Unit) -> LegAngles:
        """Return the angles in degrees. Raises as `set`. Warn if the first look like radians."""
        read = legs_angles(angles, unit)
        if not read:
            raise ValueError("no leg is given")
        if not self._sent and pace.like_radians(angle for leg in read.values() for angle in leg):
            warnings.warn(pace.LIKE_RADIANS, stacklevel=3)
        if self._rival is not None and not self._warned:
            self._warned = True
            warnings.warn(f"{self._rival}; both may move it, as there is no lease: see Client.lease", stacklevel=3)
        return read

    def send(self, angles: LegAngles) -> None:
        """Check and send at once, with the errors of `set`. @private"""
        self._client.check_open()
        if not self._open:
            raise not_open("stream", closed=self._open is False)
        if self._over is not None:
            raise self._over.with_traceback(None)
        with self._sending:
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
                self._raise(error)

    def _publish(self, angles: LegAngles) -> None:
        self._client.publish(keys.LEGS_COMMAND, {"source": self._client.name, "legs": setpoints("set", angles)})
        self._sent = {**self._sent, **angles}
        self._doubt.sent(time.monotonic())

    def _hold(self, error: StoppedError) -> frozenset[int]:
        """Repeat the angles of the legs that this error leaves running. Return these legs.

        The gateway rejects a message that names a stopped leg as a whole, so the others are near their watchdog.
        """
        left = self._started - frozenset(error.legs)
        if left:
            with suppress(ZenohError):
                self._publish({leg: self._sent[leg] for leg in left})
        return left

    def _raise(self, error: StoppedError | RejectedError | DisconnectedError) -> NoReturn:
        lost = error if isinstance(error, LeaseLostError) else None
        all_stopped = isinstance(error, StoppedError) and not self._hold(error)
        may_be = all_stopped or (isinstance(error, RejectedError) and error.reason in NOT_OURS)
        if lost is None and may_be and self._lease is not None:  # a takeover stops all legs and rejects later commands
            lost = self._lease.confirm()
        if lost is not None:
            self._over = lost
            raise lost from (None if lost is error else error)
        if not isinstance(error, RejectedError):
            self._over = error
        if self._over is error:
            self._retries.asked(time.monotonic())
            if stopped.passes(error):
                error.add_note(stopped.AGAIN)
            elif isinstance(error, StoppedError):
                error.add_note(stopped.DECIDES)
        raise error

    def _still(self) -> GatewayError | None:
        """Return why the legs cannot be started now, or None."""
        try:
            state = self._client.state(CONFIRM_S)
        except ZenohError as error:
            return error
        if (why := stopped.unready(state, reset=self._client.reset_command)) is not None:
            return why
        return None if self._client.carried_lease else stopped.not_free(state)

    def _start(self, angles: LegAngles) -> None:
        new = {leg: each for leg, each in angles.items() if leg not in self._started}
        old = {leg: each for leg, each in angles.items() if leg in self._started}
        legs = setpoints("start", new) | setpoints("set", old)
        before = self._to_stop
        self._acquire()
        self._to_stop = self._to_stop.union(new)  # without an answer they may run
        self._lease = self._client.carried_lease
        self._received_stop.clear()
        asked_s = time.monotonic()
        try:
            ack = self._client.ask(keys.LEGS_COMMAND, {"source": self._client.name, "legs": legs})
        except LeaseLostError:  # so it was rejected
            self._to_stop = before
            raise
        if not ack.accepted:
            self._to_stop = before
            self._over = _rejected(ack)
            raise self._over
        self._retries.succeeded()
        first = not self._started
        sent_s = time.monotonic()
        self._doubt.sent(sent_s)
        self._started = self._started.union(new)
        self._sent = {**self._sent, **angles}
        if sent_s - asked_s > self._doubt.watchdog_s / _SLOW:  # the next question takes as long again
            self._publish(angles)
        self._since = self._ask().time
        if first:
            self._pace.begin(sent_s)

    def _acquire(self) -> None:
        if not self._wants_lease or (self._own is not None and self._own.held):
            return
        self._release()
        try:
            self._own = own_lease(self._client)
        except LeaseError as error:
            self._over = error
            raise

    def _release(self) -> None:
        own, self._own = self._own, None
        if own is not None:
            own.release()

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
        received = ReceivedEvent(event, time.monotonic())
        self._doubt.received(received.received_s)
        if event.kind == Kind.COMMAND_REJECTED:
            # A command with a leg that is not ours is another stream's, of the same client.
            named_ours = self._started.issuperset(event.legs)
            own = self._is_own(event.source, event.source_id)
            if own and event.key == keys.LEGS_COMMAND and named_ours:
                self._events.append(received)
        elif event.kind == Kind.STARTED or (isinstance(event.kind, Kind) and event.kind.stops):
            others = event.legs and not self._started.intersection(event.legs)
            if not others and stopped.tells(event):
                self._events.append(received)
                self._received_stop.set()
            elif not others:
                self._doubt.raise_it()
        elif event.kind == Kind.SOURCE_CHANGED:
            # We took a leg from another source. One that takes a leg from us may also stop it.
            ours = self._is_own(event.source, event.source_id) and self._lease is None
            if ours and self._to_stop.intersection(event.legs):
                self._rival = event.detail

    def _is_own(self, source: str | None, source_id: str | None) -> bool:
        """Return whether this program has this name and id. None: an older gateway, or the command had no id."""
        return source == self._client.name and source_id in (None, self._client.zid)

    def _name_of(self, sent: Event | LegReport) -> str:
        return stopped.sender(sent.source, self._client.name, own=self._is_own(sent.source, sent.source_id))

    # ---- what follows from it

    def _check(self) -> None:
        """Raise the error for events since the latest call."""
        fresh = self._fresh_events()
        if (error := self._reported_stop(fresh)) is not None:
            raise error
        if fresh:
            self._ask()  # raises with a better reason if legs do not run
            rejected, _ = fresh[0]
            raise RejectedError(rejected.reason or "", rejected.detail)
        if self._doubt.is_there(time.monotonic()) or not self._client.connected:
            self._ask()

    def _fresh_events(self) -> list[ReceivedEvent]:
        """Return the events since the latest call, without those of motion before the start."""
        events = [self._events.popleft() for _ in range(len(self._events))]
        return [each for each in events if self._since is not None and each.event.time > self._since]

    def _reported_stop(self, events: Iterable[ReceivedEvent]) -> StoppedError | None:
        """Return the error for all events that stopped this stream's legs, or None."""
        stops = [each for each in events if each.event.kind != Kind.COMMAND_REJECTED]
        timeout_ms = self._doubt.watchdog_s * 1000
        return stopped.reported(stops, self._started, timeout_ms, self._name_of) if stops else None

    def _ask(self) -> GatewayState:
        """Ask for the state and return it. Raises unless all started legs run."""
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
        """Return the legs that the end of this stream must not stop, by a state newer than the answers to our starts.

        A leg that does not run is no longer ours: only another client can start it again. While another client holds
        the lease, a leg with another source is theirs: the takeover has stopped ours.
        """
        name, zid = self._client.name, self._client.zid
        ours_only = state.lease.holder is None or (self._lease is not None and self._lease.held)
        return frozenset(
            each.leg
            for each in state.legs
            if not any(servo.running for servo in each.servos) or not (ours_only or each.is_of(name, zid))
        )

    def _stopped_legs(self, state: GatewayState) -> frozenset[int]:
        return self._started & {each.leg for each in state.legs if not all(servo.running for servo in each.servos)}

    def _stopped(self, state: GatewayState) -> StoppedError:
        legs = self._stopped_legs(state)
        if (why := stopped.unready(state, legs)) is not None:
            return why
        if silent := [each.leg for each in state.legs if each.leg in legs and each.watchdog == WatchdogState.EXPIRED]:
            return stopped.expired(silent, state.watchdog.timeout_ms)
        self._received_stop.wait(_EVENT_S)
        if (reported := self._reported_stop(self._fresh_events())) is not None:
            return reported
        ours = [each for each in state.legs if each.leg in legs]
        sent = next((each for each in ours if each.source is not None), ours[0])
        return stopped.stopped_by(sent.source, self._name_of(sent), legs)


def not_open(what: str, *, closed: bool) -> RuntimeError:
    """Return the error for the use of a stream or a walk before it is opened, or after it was closed, on any thread."""
    if closed:
        return RuntimeError(f"this {what} is closed: close(), or the end of its client, has ended it")
    return RuntimeError(f"a {what} is used in a `with`, or between `open` and `close`")


@contextmanager
def noted(error: BaseException | None, what: str) -> Iterator[None]:
    """If `what` inside the `with` fails after `error`, make its failure a note of `error`."""
    try:
        yield
    except GatewayError as failed:
        if error is None:
            raise
        error.add_note(f"and {what}: {failed}")


def checked_hz(hz: float) -> float:
    """Return `hz`. Raises ValueError unless 0 < hz ≤ 1000."""
    if not 0 < hz <= MAX_HZ:
        raise ValueError(f"{hz:g} Hz; a stream's rate is above 0 and at most {MAX_HZ}")
    return hz


def _rejected(ack: Ack) -> RejectedError:
    error = RejectedError(ack.reason or "", ack.detail or "")
    if error.reason == Reason.WHOLE_ROBOT:
        error.add_note(WHOLE)
    return error
