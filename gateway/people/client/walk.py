"""Walking: velocities in place of angles. A walker (gateway/people/walking) beside a stream, on a thread of its own."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

from gateway.errors import GatewayError, RejectedError, StoppedError, UnansweredError, WalkError
from gateway.geometry import Geometry, load
from gateway.people.client.stream import Stream, checked_hz
from gateway.people.walking import HOLD_S, REST_S, Body, Posture, Robot, Velocity, Walker, WalkState
from gateway.people.walking.gaits import gait as gait_named
from gateway.people.walking.robot import check_mirrored_once, ranges
from schemas.robot import LEGS
from schemas.telemetry import GatewayState, Reason

if TYPE_CHECKING:
    from gateway.people.client.blocking import Client
    from gateway.people.client.lease import Lease

LONGEST_S: Final = 30.0
"""No way to a posture takes so long, with servos ten times slower than usual ones."""
_SLOWER: Final = 0.98
"""Of `limits.leg_rate_hz`, where that is below the rate asked for: at exactly the limit setpoints wait for slots."""


class Walk:
    """Walks, stands and sits; made by `Client.walk`, used in a `with`.

    It drives under the client's lease, or acquires it for its own time. Each call raises what a stream's does
    (StoppedError, RejectedError, LeaseLostError, DisconnectedError), and WalkError for what these legs cannot do.

    A velocity holds for `hold_s`; then the robot finishes its step and stands, so a program that hangs does not walk
    on. Whoever calls nothing for `rest_s` has it sit down, and its servos stopped. At the end of the `with` it sits
    down and is stopped, after an error it is stopped at once. If the process dies, the gateway's watchdog stops it.

    A leg that somebody else stops ends the walk: the others are put down and stand still, and every call raises
    StoppedError with that leg in `legs`, until `start_again`. For one thread at a time.

    With `wait=False` a call returns at once, for programs that have a clock of their own, and look at `state`.

    >>> with Client(endpoint) as robot, robot.walk() as walk:
    ...     walk.stand()
    ...     for _ in range(50):
    ...         walk.go(forward_m_s=0.1)               # waits for the next tick, a fiftieth of a second
    ...     went_m = walk.state.odometry.x_m
    ...     walk.sit()
    >>> 0.02 < went_m < 0.1
    True
    """

    def __init__(self, client: "Client", gait: str, geometry: Geometry | Path | str | None, hz: float) -> None:
        """See `Client.walk`. Raises WalkError for a gait that there is not, ConfigError for a faulty geometry file, and
        ValueError for a rate that no stream has."""
        gait_named(gait)
        self._client = client
        self._gait = gait
        if not isinstance(geometry, Geometry):
            geometry = load(None if geometry is None else Path(geometry))
        self._geometry = geometry
        self._hz = self._rate_hz = checked_hz(hz)
        self._revision = 0
        self._legs_found: frozenset[int] = frozenset()
        self._hold_s, self._rest_s = HOLD_S, REST_S
        self._lease: Lease | None = None
        self._stream: Stream | None = None
        self._walker: Walker | None = None
        self._thread: threading.Thread | None = None
        self._changed = threading.Condition()
        """Held while the walker is used."""
        self._error: GatewayError | None = None
        self._wanted = False
        """Somebody has asked for something since the legs were last stopped."""
        self._closing = False
        self._ticks = 0
        self._awaited: Posture | None = None
        """Cleared when it is reached."""
        self.slowest_tick_s = 0.0
        """What the longest tick took to compute and to hand over to Zenoh, without the wait for its time."""

    # ---- what a program calls

    def go(
        self, forward_m_s: float = 0.0, left_m_s: float = 0.0, turn_rad_s: float = 0.0, *, wait: bool = True
    ) -> None:
        """Walk at this velocity for `hold_s` from now on; waits for the next tick, so a loop needs no other clock.

        A robot that does not stand yet stands up first. `state.scaled` states what of a velocity the legs can do.
        """
        velocity = Velocity.checked(forward_m_s, left_m_s, turn_rad_s)
        self._check()
        with self._changed:
            self._using().go(velocity, time.monotonic())
            self._begin()
        ticks = self._ticks
        if wait:
            self._wait_for(lambda: self._ticks > ticks)

    def stand(
        self, height_m: float | None = None, roll_rad: float = 0.0, pitch_rad: float = 0.0, *, wait: bool = True
    ) -> None:
        """Stand with the body that high above the ground (None: as before), leaning right and forward; waits for it."""
        self._check()
        walker = self._using()
        body = walker.engine.stance.body
        if height_m is not None or roll_rad or pitch_rad:
            body = Body(body.height_m if height_m is None else height_m, roll_rad, pitch_rad)
        stance = walker.engine.robot.stance(body)
        with self._changed:
            walker.stand(stance, time.monotonic())
            self._begin(Posture.STANDING)
        if wait:
            self._wait_for(lambda: self._awaited is None)

    def sit(self, *, wait: bool = True) -> None:
        """Lie down on the belly; waits for it. The servos hold on until the `with` ends, or `rest_s` is over."""
        self._check()
        with self._changed:
            self._using().sit(time.monotonic())
            self._begin(Posture.SITTING)
        if wait:
            self._wait_for(lambda: self._awaited is None)

    def walk_as(self, gait: str) -> None:
        """Another gait; the walk pauses for the change. Raises WalkError for one that there is not."""
        gait_named(gait)
        with self._changed:
            self._gait = gait
            self._using().walk_as(gait, time.monotonic())

    def start_again(self) -> None:
        """Go on after an error, which a person decides. Lost legs start where they were; else it begins anew, lying.

        A lease of its own that was lost is acquired again. Raises LeaseError where somebody else drives.
        """
        with self._changed:
            if self._error is None:
                return
            walker = self._using()
            has_lost_lease = self._lease is not None and self._lease.lost is not None
            if has_lost_lease:
                lease = self._client.lease()
                lease.acquire()
                self._lease = lease
            self._error = None
            if walker.engine.lost and self._stream is not None and not has_lost_lease:
                walker.engine.resume()
                return
            self._end_stream()
            self._wanted = False
            self._walker = self._found()

    @property
    def error(self) -> GatewayError | None:
        """What has ended it, and what each call raises, until `start_again`."""
        return self._error

    @property
    def state(self) -> WalkState:
        """What it is doing: posture, commanded and scaled velocity and why, odometry, lost legs."""
        with self._changed:
            return self._using().state

    @property
    def hold_s(self) -> float:
        """How long a velocity holds; 0.5 unless it is set."""
        return self._hold_s

    @hold_s.setter
    def hold_s(self, seconds: float) -> None:
        self._hold_s = _seconds(seconds)
        if self._walker is not None:
            self._walker.hold_s = self._hold_s

    @property
    def rest_s(self) -> float:
        """After how long without a call it sits down and is stopped; 10 unless it is set."""
        return self._rest_s

    @rest_s.setter
    def rest_s(self, seconds: float) -> None:
        self._rest_s = _seconds(seconds)
        if self._walker is not None:
            self._walker.rest_s = self._rest_s

    # ---- begin and end

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close(sits=error is None)
        except GatewayError as failed:
            if error is None:
                raise
            error.add_note(f"and the end of the walk: {failed}")

    def open(self) -> None:
        """Acquire the lease, read limits and calibration. Nothing moves. Raises as the class states, and LeaseError."""
        if self._thread is not None:
            raise RuntimeError("a walk is used once; make a new one with `walk()`")
        if self._client.walks:
            raise RuntimeError("this client walks already")
        if self._client.carried_lease is None:
            lease = self._client.lease()
            with suppress(UnansweredError):  # a gateway that knows of no lease
                lease.acquire()
                self._lease = lease
        try:
            self._walker = self._found()
        except BaseException:
            self._release()
            raise
        self._client.walks = True
        self._wanted = len(self._legs_found) == len(LEGS)  # that run, so the watchdog waits for them
        self._thread = threading.Thread(target=self._run, name="walk", daemon=True)
        self._thread.start()

    def close(self, *, sits: bool = True) -> None:
        """Sit down, if it can, and stop the legs. Raises what went wrong meanwhile."""
        try:
            if sits and self._error is None and self._stream is not None and self._walker is not None:
                self.sit()
        finally:
            with self._changed:
                self._closing = True
                self._changed.notify_all()
            if self._thread is not None:
                self._thread.join()
                self._client.walks = False
            try:
                self._end_stream()
            finally:
                self._release()

    # ---- inside

    def _release(self) -> None:
        lease, self._lease = self._lease, None
        if lease is not None:
            lease.release()

    def _end_stream(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()

    def _found(self) -> Walker:
        """The robot as it is now: its limits, its calibration, and where the legs are that run."""
        state = self._client.state()
        robot = robot_of(self._client, self._geometry, state)
        self._revision = state.calibration.revision
        rate_hz = state.limits.leg_rate_hz
        self._rate_hz = self._hz if self._hz <= rate_hz else _SLOWER * rate_hz
        pose: dict[int, tuple[float, float, float]] = {}
        for leg in state.legs:
            angles = [servo.angle_deg for servo in leg.servos if servo.running and servo.angle_deg is not None]
            if len(angles) == len(leg.servos):
                pose[leg.leg] = angles[0], angles[1], angles[2]
        self._legs_found = frozenset(pose)
        return Walker(robot, self._gait, pose, hold_s=self._hold_s, rest_s=self._rest_s)

    def _using(self) -> Walker:
        if self._walker is None or self._closing:
            raise RuntimeError("a walk is used in a `with`, and is over after it")
        return self._walker

    def _check(self) -> None:
        if self._error is not None:
            raise self._error.with_traceback(None)

    def _begin(self, awaited: Posture | None = None) -> None:
        self._wanted, self._awaited = True, awaited
        self._changed.notify_all()

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        with self._changed:
            there = self._changed.wait_for(lambda: self._error is not None or condition(), LONGEST_S)
            self._check()
            if not there:
                raise WalkError(f"after {LONGEST_S:g} s it is still {self._using().engine.posture}")

    # ---- its thread

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closing or self._runs)
                if self._closing:
                    return
            try:
                self._tick()
            except StoppedError as error:
                self._stopped(error)
            except RejectedError as error:
                # A setpoint that was late is left out. After a start that was late, the stream sends nothing more.
                if error.reason != Reason.STALE or self._stream is None or self._stream.is_over:
                    self._fail(error)
            except (GatewayError, ValueError, RuntimeError) as error:
                self._fail(error if isinstance(error, GatewayError) else WalkError(str(error)))

    @property
    def _runs(self) -> bool:
        lost = self._walker is not None and bool(self._walker.engine.lost)
        return self._wanted and (self._error is None or lost)

    def _tick(self) -> None:
        stream = self._stream
        if stream is None:
            if self._client.state().calibration.revision != self._revision:
                raise WalkError(
                    "the calibration has changed since the walk began; start_again() goes on with the new one"
                )
            stream = self._client.stream(self._rate_hz)
            stream.open()
            self._stream = stream
            self._start(stream)
        begun_s = time.monotonic()
        with self._changed:
            walker = self._using()
            pose = walker.tick(begun_s)
            over = walker.is_over
            if walker.engine.posture is self._awaited:
                self._awaited = None
        computed_s = time.monotonic() - begun_s
        stream.set(pose)
        with self._changed:
            self._ticks += 1
            self.slowest_tick_s = max(self.slowest_tick_s, computed_s)
            if over:
                self._wanted = False
            self._changed.notify_all()
        if over:
            self._end_stream()

    def _start(self, stream: Stream) -> None:
        """One leg more at each call: their servos go where they belong as fast as they can, and draw most then."""
        pose = self._using().engine.pose
        started: dict[int, tuple[float, float, float]] = {leg: pose[leg] for leg in self._legs_found}
        if started:
            stream.set(started)
        for leg in LEGS:
            if leg not in started and not self._closing:
                started[leg] = pose[leg]
                stream.set(started)

    def _stopped(self, error: StoppedError) -> None:
        """By somebody else: the legs that are left stand still. With none left, or by a fault, it is over."""
        if self._closing or self._walker is None:  # nobody waits for it any more, and the legs are being stopped
            return
        walker, stream = self._walker, self._stream
        left = frozenset(LEGS) - walker.engine.lost - frozenset(error.legs)
        if not left or stream is None:
            self._fail(error)
            return
        with self._changed:
            walker.engine.halt(error.legs)
            legs = ", ".join(map(str, sorted(walker.engine.lost)))
            self._error = StoppedError(
                f"leg {legs} is stopped, and the others stand still: {error}", walker.engine.lost
            )
            self._changed.notify_all()
        stream.go_on_without(error.legs)

    def _fail(self, error: GatewayError) -> None:
        with self._changed:
            self._error = error
            self._wanted = False
            self._changed.notify_all()


def robot_of(client: "Client", geometry: Geometry, state: GatewayState) -> Robot:
    """This robot within the limits and the calibration that are in force. Raises WalkError where both mirror it."""
    calibration = None
    with suppress(UnansweredError):  # an older gateway has none
        calibration = client.calibration()
    check_mirrored_once(geometry, calibration)
    return Robot(geometry, ranges(state.limits, calibration))


def _seconds(seconds: float) -> float:
    if not 0 < seconds < float("inf"):
        raise ValueError(f"{seconds} s; a time above 0 is needed")
    return float(seconds)
