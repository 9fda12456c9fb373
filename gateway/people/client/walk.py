"""Walking by velocities: a `Ride` (gateway/people/walking) with a thread, a connection and a clock."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self, TypeVar
from weakref import finalize

import zenoh

from gateway.errors import GatewayError, RejectedError, StoppedError, WalkError
from gateway.geometry import Geometry, load
from gateway.people.client import stopped
from gateway.people.client.lease import DrivingClient, Lease, own_lease
from gateway.people.client.pace import Retries
from gateway.people.client.process_end import WalkSignals, forked
from gateway.people.client.stream import Stream, checked_hz, not_open, noted
from gateway.people.client.subscriptions import undeclare
from gateway.people.walking.balance import ReceivedTelemetry, terrain_named
from gateway.people.walking.gait_speed import Distance
from gateway.people.walking.gaits import gait as gait_named
from gateway.people.walking.motion import BodyPose, Posture, Velocity, WalkState
from gateway.people.walking.ride import USUAL_SILENCES, Phase, Ride, RideStep, RideTask, Silences
from gateway.people.walking.robot import Robot, check_mirrored_once, ranges, running_deg
from gateway.people.walking.transitions import LONGEST_S
from gateway.people.walking.words import Newest
from schemas.gateway_state import GatewayState
from schemas.robot import LEGS
from schemas.words import Reason

T = TypeVar("T")

_SLOWER: Final = 0.98
"""The part of `limits.leg_rate_hz` used if the wanted rate is higher: at the limit, setpoints wait for slots."""


def _silence(name: str, text: str) -> Any:
    return property(
        lambda walk: getattr(walk._silences, name), lambda walk, seconds: walk._set_silence(name, seconds), doc=text
    )


class Walk:
    """Walks, stands and sits; made by `Client.walk`. Use it in a `with`, or call `open` and `close`.

    It drives under the client's lease, or acquires it for its own time. Each call raises what a stream's does
    (StoppedError, RejectedError, LeaseLostError, DisconnectedError), and WalkError for what these legs cannot do.

    A velocity holds for `hold_s`; then the robot finishes its step and stands, also if the program hangs. After
    `rest_s` without a call the robot sits down, and its servos are stopped. The end of the `with` does the same; after
    an error the servos are stopped at once. At `sys.exit`, Ctrl-C, or SIGTERM without a handler in the main thread, the
    robot sits down; a second signal stops it at once. The end of the client, or of the program, closes an open walk. If
    the process dies, the gateway's watchdog stops the robot. A walk that its program drops is closed, too.

    A leg that somebody else stops ends the walk: the others are put down and stand still, and every call raises
    StoppedError with that leg in `legs`, until `start_again`. For one thread at a time.

    With `wait=False` a call returns at once, for programs that have their own clock and read `state`.

    >>> with Client(endpoint) as robot, robot.walk() as walk:
    ...     walk.stand()
    ...     for _ in range(50):
    ...         walk.go(forward_m_s=0.1)               # waits for the next tick, a fiftieth of a second
    ...     went_m = walk.state.odometry.x_m
    ...     walk.sit()
    >>> 0.02 < went_m < 0.1
    True
    """

    def __init__(
        self,
        client: DrivingClient,
        gait: str,
        geometry: Geometry | Path | str | None,
        hz: float,
        *,
        terrain: str = "level",
        silences: Silences = USUAL_SILENCES,
        once: bool = False,
    ) -> None:
        """See `Client.walk`, and `Ride` for `silences` and `once`.

        Raises WalkError for an unknown gait or terrain, ConfigError for a faulty geometry file, ValueError for a rate
        that no stream has. @private
        """
        gait_named(gait)
        self._terrain = terrain_named(terrain)
        self._measured = ReceivedTelemetry()
        self._client = client
        self._gait = gait
        if not isinstance(geometry, Geometry):
            geometry = load(None if geometry is None else Path(geometry))
        self._geometry = geometry
        self._hz = self._rate_hz = checked_hz(hz)
        self._silences, self._once = silences, once
        self._revision = 0
        self._lease: Lease | None = None
        self._stream: Stream | None = None
        self._retries = Retries()
        self._ride: Ride | None = None
        self._thread: threading.Thread | None = None
        self._inner: Walk | None = None  # this walk for its thread, the client and Zenoh, so that a program may drop it
        self._changed = threading.Condition()  # notified after each change; also the lock of the ride
        self._not_again: Exception | None = None  # why `start_again` failed
        self._closing = False
        self._signals = WalkSignals()
        self._newest = Newest()
        self._subscribers: list[zenoh.Subscriber[None]] = []
        self._ticks = 0
        self._awaited: Posture | None = None  # which a call waits for, until it is reached

    # ---- what a program calls

    def go(
        self, forward_m_s: float = 0.0, left_m_s: float = 0.0, turn_rad_s: float = 0.0, *, wait: bool = True
    ) -> None:
        """Walk at this velocity for `hold_s`. Waits for the next tick, so a loop needs no other clock.

        A robot that does not stand yet stands up first. `turn_rad_s`: counter-clockwise above 0. `state.scaled` is the
        velocity that the legs can reach. Raises WalkError above 10 m/s or rad/s.
        """
        velocity = Velocity.checked(forward_m_s, left_m_s, turn_rad_s)
        try:
            self.use(lambda ride, now_s: ride.go(velocity, now_s))
            ticks = self._ticks
            if wait:
                self._wait_for(lambda: self._ticks > ticks)
        except GatewayError:
            time.sleep(1 / self._rate_hz if wait else 0)  # a loop that ignores errors keeps its rate
            raise

    def ahead(self, metres: float) -> None:
        """Walk this far by `state.odometry` (below 0: backward, at most 20 m), and return when the robot stands.

        Raises as `go`, and WalkError if the robot comes no nearer. After an exception, such as Ctrl-C, the robot stands
        within `hold_s` and a stride.
        """
        self._cover(Distance(metres, turns=False))

    def turn(self, radians: float) -> None:
        """Turn in place by this angle (above 0: counter-clockwise, at most 4π), and stand. Raises as `ahead`."""
        self._cover(Distance(radians, turns=True))

    def stand(
        self, height_m: float | None = None, roll_rad: float = 0.0, pitch_rad: float = 0.0, *, wait: bool = True
    ) -> None:
        """Stand with the body this high (None: as before), leaning right and forward. Waits until the robot stands."""

        def stand(ride: Ride, now_s: float) -> None:
            height = ride.body.height_m if height_m is None else height_m
            as_before = height_m is None and not roll_rad and not pitch_rad
            ride.stand(None if as_before else BodyPose(height, roll_rad, pitch_rad), now_s)

        self._reach(Posture.STANDING, stand, wait)

    def sit(self, *, wait: bool = True) -> None:
        """Lie down on the belly, and wait until it lies. The servos stay on until the `with` ends, or for `rest_s`."""
        self._reach(Posture.SITTING, Ride.sit, wait)

    def walk_as(self, gait: str) -> None:
        """Change the gait; the walk pauses meanwhile. Raises WalkError for an unknown one."""
        self.use(lambda ride, now_s: ride.walk_as(gait, now_s))

    def start_again(self) -> None:
        """Go on after an error, by a person's decision. Acquires a lost lease of its own again.

        If the other legs carry the robot, lost legs start where they were. Else all are stopped, and the next call
        begins from lying. Raises LeaseError if somebody else drives, StoppedError if the gateway accepts no commands.
        """
        time.sleep(max(0.0, self._retries.next_s - time.monotonic()))
        self._retries.asked(time.monotonic())
        with self._changed:
            self._not_again = None
            self.use(lambda ride, _: ride.start_again())
            ended = self._changed.wait_for(lambda: not self._using().wants_again, LONGEST_S)
            if not ended or self._not_again is not None:
                raise self._not_again or WalkError(f"after {LONGEST_S:g} s the gateway has not answered")

    def use(self, do: Callable[[Ride, float], T]) -> T:
        """Call `do` with the ride and the time, and wake the walking thread. @private"""
        with self._changed:
            self._changed.notify_all()  # it wakes when this is done
            return do(self._using(), time.monotonic())

    @property
    def error(self) -> GatewayError | None:
        """The error that ended the walk; each call raises it until `start_again`. @private"""
        return None if self._ride is None else self._ride.error

    @property
    def state(self) -> WalkState:
        """Posture, commanded and scaled velocity, the reason for scaling, odometry, lost legs; see `WalkState`."""
        with self._changed:
            return self._using().state

    @property
    def latest(self) -> WalkState | None:
        """The state, even after `close`; None before `open`. @private"""
        with self._changed:
            return None if self._ride is None else self._ride.state

    @property
    def now(self) -> str:
        """One sentence on what the robot does (`It walks`), or that the newest state is over 1 s old."""
        with self._changed:
            ride = self._using()
            # Legs that it has not started yet were not stopped.
            return self._newest.sentence(time.monotonic(), None if ride.phase is Phase.STARTS else ride.state)

    @property
    def is_over(self) -> bool:
        """Whether it ended by its driver's silence, and all its legs are stopped. @private"""

        def check(ride: Ride, now_s: float) -> bool:
            ride.apply_silences(now_s)
            return ride.over

        return self.use(check)

    hold_s: float = _silence("hold_s", "How long a velocity holds, in seconds; 0.5 by default.")
    rest_s: float = _silence("rest_s", "After how many seconds without a call it sits and is stopped; 10 by default.")

    # ---- begin and end

    def __repr__(self) -> str:
        doing = "closed" if self._ride is None or self._closing else str(self._ride.posture)
        return f"<Walk {self._gait}, {doing}>"

    def __enter__(self) -> Self:
        self.open()
        self._signals.begin()
        return self

    def __exit__(self, _kind: Any, error: BaseException | None, _trace: Any) -> None:
        with self._signals.end(), noted(error, "the end of the walk"):
            # The end of a program must not drop the robot; a second signal interrupts the sitting down.
            self.close(sits=error is None or isinstance(error, KeyboardInterrupt | SystemExit))

    def open(self) -> Self:
        """Acquire the lease, and read limits and calibration. Moves nothing. Raises as calls do, or LeaseError."""
        if self._thread is not None:
            raise RuntimeError("a walk is used once; make a new one with `walk()`")
        if any(isinstance(each, Walk) for each in self._client.open_parts):
            raise RuntimeError("this client walks already")
        self._lease = own_lease(self._client)
        self._inner = inner = object.__new__(type(self))
        inner.__dict__ = self.__dict__
        try:
            self._subscribers.append(self._client.on_state(inner._take))
            if self._terrain == "adapt":
                measured = self._client.on_telemetry(lambda new: inner._measured.take(new, time.monotonic()))
                self._subscribers.append(measured)
            state = self._ask()
            self._ride = Ride(
                self._robot(state),
                self._gait,
                running_deg(state),
                self._silences,
                once=self._once,
                now_s=time.monotonic(),
                terrain=self._terrain,
            )
        except BaseException:
            self._inner = None
            self._release()
            raise
        self._client.open_parts[inner] = None
        self._thread = threading.Thread(target=inner._run, name="walk", daemon=True)
        self._thread.start()
        finalize(self, dropped, inner).atexit = False
        return self

    def close(self, *, sits: bool = True) -> None:
        """Sit down (`sits`, unless an error prevents it), and stop the legs. Raises the errors of both."""
        try:
            with self._changed:
                sits = sits and not self._closing and self.error is None and self._stream is not None
                if sits:
                    self.sit(wait=False)
            if sits:
                self._wait_for(lambda: self._awaited is None)
        finally:
            self.end_now()
            if self._thread is not None:
                self._thread.join()
            if self._inner is not None:
                self._client.open_parts.pop(self._inner, None)
                self._inner = None
            try:
                self._end_stream()
            finally:
                self._release()

    def end_now(self) -> None:
        """Send nothing more. A `close` on another thread then stops the legs without sitting down. @private"""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    # ---- inside

    def _reach(self, posture: Posture, do: Callable[[Ride, float], None], wait: bool) -> None:
        with self._changed:
            self.use(do)
            self._awaited = posture
        if wait:
            self._wait_for(lambda: self._awaited is None)

    def _cover(self, distance: Distance) -> None:
        while (velocity := distance.next(self.state, time.monotonic())) is not None:
            self.go(*velocity)
        self.stand()

    def _set_silence(self, name: str, seconds: float) -> None:
        if not 0 < seconds < float("inf"):
            raise ValueError(f"{seconds} s; a time above 0 is needed")
        with self._changed:
            self._silences = silences = self._silences._replace(**{name: float(seconds)})
            if self._ride is not None:
                self._ride.silences = silences

    def _release(self) -> None:
        undeclare(self._subscribers)
        if self._lease is not None:
            self._lease.release()

    def _end_stream(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    def _ask(self) -> GatewayState:
        state = self._client.state()
        self._take(state)
        return state

    def _take(self, state: GatewayState) -> None:
        self._newest.take(state, time.monotonic())

    def _robot(self, state: GatewayState) -> Robot:
        """Return the robot with its current limits and calibration. Set a rate that the limits allow.

        Raises WalkError if geometry and calibration both mirror it.
        """
        calibration = self._client.calibration()
        check_mirrored_once(self._geometry, calibration)
        self._revision = state.calibration.revision
        most_hz = state.limits.leg_rate_hz
        self._rate_hz = self._hz if self._hz <= most_hz else _SLOWER * most_hz
        limits = ranges(state.limits, calibration)
        return Robot(self._geometry, limits, starts_whole=state.wire.whole_robot, fed_singly=state.power is not None)

    def _using(self) -> Ride:
        if self._ride is None or self._closing:
            raise not_open("walk", closed=self._closing)
        return self._ride

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        with self._changed:
            there = self._changed.wait_for(lambda: self.error is not None or self._closing or condition(), LONGEST_S)
            if self.error is not None:
                raise self.error.with_traceback(None)
            if not there:
                raise WalkError(f"after {LONGEST_S:g} s it is still {self._using().posture}")

    # ---- the walking thread: the only one that asks, starts and sets

    def _run(self) -> None:
        ride = self._using()
        while True:
            with self._changed:
                if self._closing:
                    return
                begun_s = time.monotonic()
                step = ride.next(begun_s, self._measured.fresh(begun_s))
                if step.do is RideTask.WAIT:
                    self._changed.wait(min(step.wake_s - begun_s, threading.TIMEOUT_MAX))
                    continue
            try:
                self._carry_out(ride, step)
            except (GatewayError, ValueError, RuntimeError) as error:
                self._failed(ride, step, error)
            with self._changed:
                self._changed.notify_all()

    def _carry_out(self, ride: Ride, step: RideStep) -> None:
        match step.do:
            case RideTask.FIND:
                self._find(ride)
            case RideTask.STOP:
                try:
                    self._end_stream()
                finally:
                    with self._changed:
                        ride.ended()
                        self._awaited = None if ride.over else self._awaited  # it could not sit
            case RideTask.SEND:
                if self._stream is None:
                    self._stream = Stream(self._client, self._rate_hz).open()
                self._stream.set(step.pose)
                if self._stream.answer is not None:  # to a start: newer than all published states
                    self._take(self._stream.answer)
                    self._stream.answer = None
                with self._changed:
                    ride.sent(step.pose, arrived=self._newest.arrived)
                    self._ticks += ride.phase is Phase.RUNS
                    if ride.posture is self._awaited:
                        self._awaited = None

    def _find(self, ride: Ride) -> None:
        """Ask which legs run, before legs start or the walk resumes."""
        again, robot = ride.wants_again, ride.robot
        if again and self._lease is not None and self._lease.lost is not None:
            self._lease = Lease(self._client).acquire()
        state = self._ask()
        if again and (why := stopped.unready(state, reset=self._client.reset_command)) is not None:
            raise why
        running = running_deg(state)
        changed = state.calibration.revision != self._revision
        if again and ride.phase is Phase.HALTED:
            running = {} if changed else running  # the same angles are another pose now
        elif again:
            robot = self._robot(state)
        elif changed:
            raise WalkError("the calibration has changed since the walk began")
        with self._changed:
            ride.found(robot, running, time.monotonic())

    def _failed(self, ride: Ride, step: RideStep, error: Exception) -> None:
        stream = self._stream
        if ride.wants_again and step.do is not RideTask.SEND:
            with self._changed:
                self._not_again = error
                ride.not_again(error)
        elif isinstance(error, StoppedError) and stream is not None and not self._closing:
            self._newest.stopped(error.legs)
            with self._changed:
                left = ride.stopped(error)
            if left:
                stream.go_on_without(frozenset(LEGS) - left)
        elif (
            isinstance(error, RejectedError) and error.reason == Reason.STALE and not (stream is None or stream.is_over)
        ):
            pass  # a setpoint that was late is left out; after a start that was late, the stream sends nothing more
        elif not self._closing:
            with self._changed:
                ride.failed(error if isinstance(error, GatewayError) else WalkError(str(error)))


def dropped(walk: Walk) -> None:
    """Close a walk that its program has dropped: on a thread, since the robot may have to sit down."""

    def close() -> None:
        with suppress(GatewayError):
            walk.close()

    if walk._inner is not None and not forked():
        with suppress(RuntimeError):  # the program has ended
            threading.Thread(target=close, name="close the walk").start()
