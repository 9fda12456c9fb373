"""Whether the bridge drives, and which of its motions moves the robot.

Nothing is accepted before somebody calls `drive`. While the node is inactive nobody may call it.

`drive` acquires the lease; `release` sits down and gives it back. What ends a motion by a fault ends the driving, too:
a Stop of anybody's, an emergency stop, the watchdog, a lost lease or link. After that `drive` must be called again.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final, TypeVar

from gateway.errors import GatewayError, LeaseLostError, RejectedError, StoppedError
from gateway.geometry import Geometry
from gateway.people.client.blocking import Client
from gateway.people.client.lease import Lease
from gateway.people.ros2.motions import DOES_NOT_STAND, JointCommands, Motion, Walking
from gateway.people.walking.motion import ORIGIN, Odometry, Velocity
from gateway.people.watching.dangers import UNCONFIRMED, confirmed_off
from schemas.gateway_state import GatewayState
from schemas.words import Mode, Reason

NOBODY_DRIVES: Final = "nobody has called drive"
NO_RESET: Final = "leave the emergency stop at the robot, or start the bridge with --allow-reset"
M = TypeVar("M", JointCommands, Walking)


class NotTakenError(Exception):
    """A message is rejected, with one sentence. The present motion continues."""


class Driving:
    """For any thread: one of them acts at a time."""

    def __init__(self, client: Client, name: str, geometry: Geometry, show: Callable[[str], None]) -> None:
        """`name`: the lease's holder if no certificate names one; `show` takes lines for a person."""
        self._client = client
        self._name = name
        self._geometry = geometry
        self._show = show
        self._lock = threading.RLock()
        self._lease: Lease | None = None
        self._motion: Motion | None = None
        self._estop = 0
        """The latest emergency stop's number when it began to drive."""
        self._received: GatewayState | None = None
        self._gait = "tripod"
        self._went = ORIGIN
        """The odometry of all walks that have ended."""
        self._closed = False
        self._why_not = self._inactive = "the node is not active yet"
        """Why nobody may drive; empty while driving is allowed."""

    @property
    def drives(self) -> bool:
        """Whether the bridge holds the lease and passes messages on."""
        return self._lease is not None

    @property
    def does(self) -> str:
        """Return what the bridge does, or why it rejects messages, for people."""
        motion = self._motion
        if not self.drives:
            return self._why_not
        return "drives; nothing moves" if motion is None else f"drives by {motion.title}"

    @property
    def odometry(self) -> tuple[Odometry, Velocity] | None:
        """Where all walks have carried the robot, and how fast it goes; None while it does not walk."""
        motion = self._motion
        return motion.odometry if isinstance(motion, Walking) else None

    # ---- services

    def drive(self) -> str:
        """Take messages from now on. Raises LeaseError where somebody else drives, RejectedError, DisconnectedError."""
        with self._lock:
            if self._lease is not None:
                return "it drives already"
            if self._closed:
                raise RejectedError(Reason.STOPPING, "the bridge ends")
            if self._inactive:
                raise GatewayError(self._inactive)
            state = self._client.state()
            if state.mode == Mode.ESTOPPED:
                raise RejectedError(Reason.ESTOPPED, "the emergency stop is engaged; reset leaves it")
            lease = self._client.lease(source=self._name, on_lost=self._lost, on_asked=self._asked)
            lease.acquire()
            self._lease, self._estop, self._gait = lease, state.estop, "tripod"
            self._show(f"drives as {lease.holder}")
            return f"drives as {lease.holder}"

    def release(self, *, sits: bool = True) -> str:
        """Sit down, stop the bridge's servos and give the lease back. Return a sentence. Raises GatewayError."""
        with self._lock:
            if self._lease is None:
                return self._why_not
            try:
                self._end_motion(sits=sits)
            finally:
                self._give_back(NOBODY_DRIVES)
            return "released"

    def activate(self, *, drives: bool) -> None:
        """Allow `drive` from now on; with `drives`, call it at once."""
        with self._lock:
            self._inactive, self._why_not = "", NOBODY_DRIVES
            try:
                if drives:
                    self.drive()
            except RejectedError as error:
                self._show(f"--drive: {error}; the service drive tries again")

    def deactivate(self, why: str) -> None:
        """Release, and reject `drive` until `activate`. `why`: the reason, for people."""
        with self._lock:
            self._inactive = why
            try:
                self.release()
            except GatewayError as error:  # what cannot be stopped from here is stopped by the gateway's watchdog
                self._show(f"{why}: {error}")
            finally:
                self._why_not = why

    def estop(self) -> str:
        """Engage the emergency stop without waiting for the lock. Return a sentence. Raises GatewayError."""
        ack = self._client.estop()
        within = f"within {ack.latency_us:.0f} µs{confirmed_off(ack)}"
        unconfirmed = f". {UNCONFIRMED}" if ack.confirmed is False else ""
        return f"emergency stop {ack.estop}: {ack.stop_frames} Stop frames written {within}{unconfirmed}"

    def reset(self, *, allowed: bool) -> str:
        """Leave the latest emergency stop, also a person's, if `allowed`. Return a sentence. Raises GatewayError.

        All who reach ROS 2's graph may call this, and a person who has pressed a button relies on the Stop.
        """
        if not allowed:
            raise RejectedError(Reason.ESTOPPED, NO_RESET)
        ack = self._client.reset(self._client.state().estop)
        if not ack.accepted:
            raise RejectedError(str(ack.reason), ack.detail or "")
        return "the emergency stop is left; nothing moves until it is started again"

    def close(self) -> None:
        """Stop the bridge's servos at once, and reject everything from now on, `drive` too. Raises GatewayError."""
        with self._lock:
            self._closed = True
            self.release(sits=False)

    # ---- topics; each raises NotTakenError

    def joints(self, at_rad: dict[int, float]) -> None:
        """Command these joints: servo → radians, whole legs only."""
        with self._taking():
            motion = self._using(JointCommands, lambda: JointCommands(self._client, self._geometry))
            try:
                motion.command(at_rad)
            except RejectedError as error:
                if motion.stream.is_over:
                    raise
                raise NotTakenError(str(error)) from error

    def go(self, velocity: Velocity) -> None:
        """Walk at this velocity for half a second."""
        with self._taking():
            if velocity.moves or isinstance(self._motion, Walking):
                self._walking().go(velocity)

    def stand(self, **change: float) -> None:
        """Set the body's `height_m`, which makes it stand up, or its `roll_rad` or `pitch_rad` while it stands."""
        with self._taking():
            if "height_m" in change or isinstance(self._motion, Walking):
                self._walking().stand(**change)
            elif any(change.values()):
                raise NotTakenError(DOES_NOT_STAND)

    def walk_as(self, gait: str) -> None:
        """Set the gait, until it drives no more."""
        with self._taking():
            self._gait = gait
            if isinstance(self._motion, Walking):
                self._motion.walk_as(gait)

    # ---- looked after by a thread

    def check(self) -> None:
        """End a motion that is over, and the driving after a Stop. Call it at least ten times a second."""
        with self._lock:
            try:
                self._end_what_is_over()
                state, self._received = self._received, None
                if self._motion is None and self._lease is not None and state is not None:
                    self._check_estop(state)
            except GatewayError as error:
                self._fail(error)

    def receive(self, state: GatewayState) -> None:
        """Take a published state. Never waits."""
        self._received = state

    # ---- inside, with the lock

    def _check_estop(self, state: GatewayState) -> None:
        """Raise StoppedError after an emergency stop, also if nothing moved: a reset must not resume a motion."""
        if state.estop != self._estop:  # a gateway that was started again counts anew
            raise StoppedError("an emergency stop was engaged, or the gateway started again", ())

    @contextmanager
    def _taking(self) -> Iterator[None]:
        with self._lock:
            if self._lease is None:
                raise NotTakenError(self._why_not)
            try:
                yield
            except ValueError as error:  # what the joints, or the legs, cannot do
                raise NotTakenError(str(error)) from error
            except GatewayError as error:
                self._fail(error)
                raise NotTakenError(self._why_not) from error

    def _using(self, kind: type[M], make: Callable[[], M]) -> M:
        """Return the present motion of this kind, or a new one. Raises NotTakenError while another moves the robot."""
        self._end_what_is_over()  # it has ended since the last check
        motion = self._motion
        if isinstance(motion, kind):
            return motion
        if motion is not None:
            raise NotTakenError(f"{motion.title} moves the robot; when it has ended, or after release, others can")
        self._check_estop(self._client.state())
        self._motion = made = make()
        return made

    def _walking(self) -> Walking:
        return self._using(Walking, lambda: Walking(self._client, self._geometry, self._gait, self._went))

    def _end_what_is_over(self) -> None:
        """Raise the error that has ended it."""
        if self._motion is not None and not self._motion.check():
            self._end_motion(sits=False)

    def _end_motion(self, *, sits: bool) -> None:
        motion, self._motion = self._motion, None
        try:
            if motion is not None:
                motion.end(sits=sits)
        finally:
            if isinstance(motion, Walking):
                self._went, _ = motion.odometry

    def _fail(self, error: GatewayError) -> None:
        self._show(f"{error}: call drive to go on")
        with suppress(GatewayError):  # what cannot be stopped from here is stopped by the gateway's watchdog
            self._end_motion(sits=False)
        self._give_back(f"{error.lasting}; after that {NOBODY_DRIVES}")

    def _give_back(self, why_not: str) -> None:
        lease, self._lease, self._why_not = self._lease, None, why_not
        if lease is not None:
            lease.release()

    def _lost(self, error: LeaseLostError) -> None:
        """Called on a thread of the lease."""
        with self._lock:
            if self._lease is not None and self._lease.lost is error:
                self._fail(error)

    def _asked(self, who: str) -> None:
        self._show(f"{who} asks for the lease: the service release gives it up")
