"""One page's walk: the page sends 20 times a second what it wants, and a thread of its own walks by the newest of that.

The thread drives `gateway.client.Walk` over a session of its own, with the page's lease. The loop that serves the pages
only leaves a wish for it and never waits for it, so that no STOP ALL does either.

- No wish is used twice. A page that has sent nothing for `SILENT_S` (frozen, locked, without Wi-Fi) has the robot
  finish its step and stand, `SIT_S` later sit down, and its servos stopped. A page that is closed, the same.
- Each wish carries the number of the press that it belongs to. What ends a walk (silence, an error, a Stop) uses up the
  newest press: only a newer one moves the robot again.
- A page that only shows itself, with nothing pressed for `IDLE_S`, has the robot sit down: standing heats the servos.
- Until the legs are stopped the setpoints carry the page's lease; it is given back after that.
- Where this process dies, the gateway's watchdog stops the legs.
"""

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from functools import partial
from typing import Final

import zenoh

from gateway.errors import GatewayError
from gateway.geometry import Geometry
from gateway.people.client.blocking import Client
from gateway.people.client.lease import LentLease
from gateway.people.client.walk import Walk
from gateway.people.console.messages import WalkMessage, WalkWish
from gateway.people.walking import STILL, Posture, Velocity

SILENT_S: Final = 0.25
"""Five wishes in a row are missing."""
SIT_S: Final = 5.0
IDLE_S: Final = 60.0
TICK_S: Final = 0.05
"""How long a wish is waited for, before silence is looked at."""
REPORT_S: Final = 0.1
_DOWN: Final = (Posture.LYING, Posture.SITTING)

_log: Final = logging.getLogger(__name__)


class Walking:
    """For one page, on the event loop; all walks of the page come one after the other."""

    def __init__(
        self, connect: Callable[[str], Client], name: str, geometry: Geometry, send: Callable[[WalkMessage], None]
    ) -> None:
        """`connect` opens a session under a name, and waits for that; it is called on a thread."""
        self._loop = asyncio.get_running_loop()
        self._connect = connect
        self._name = name
        self._geometry = geometry
        self._send = send
        self._ride: _Ride | None = None
        self._spent = -1
        """The newest press that has been used."""

    @property
    def active(self) -> bool:
        """Whether legs may run by it."""
        return self._ride is not None and self._ride.is_alive()

    def take(self, wish: WalkWish, token: str | None) -> None:
        """A wish that is fresh. `token` is the page's lease; without it nothing begins."""
        if self._ride is not None:
            if self._ride.is_alive():
                self._ride.take(wish)
                return
            self._spent, self._ride = max(self._spent, self._ride.spent), None
        if wish.press <= self._spent or wish.sits:
            return
        self._spent = wish.press
        if token is None:
            self._send(WalkMessage(press=wish.press, detail="this page does not have the lease; press Drive first"))
            return
        self._ride = _Ride(self._connect, self._name, self._geometry, token, wish, partial(self._later, self._send))
        try:
            self._ride.start()
        except RuntimeError as error:  # no thread
            self._ride = None
            self._send(WalkMessage(press=wish.press, detail=str(error)))

    def when_over(self, then: Callable[[], None], *, sits: bool) -> None:
        """Call `then` once the legs are stopped; with `sits` it sits down now, else when the page's silence has it."""
        if self._ride is None or not self._ride.when_over(partial(self._later, then), sits=sits):
            then()

    def _later(self, call: Callable[..., None], *arguments: object) -> None:
        """For the walk's thread."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(call, *arguments)


class _Ride(threading.Thread):
    """One walk, from the press that begins it until its servos are stopped."""

    def __init__(
        self,
        connect: Callable[[str], Client],
        name: str,
        geometry: Geometry,
        token: str,
        wish: WalkWish,
        send: Callable[[WalkMessage], None],
    ) -> None:
        super().__init__(name="walk for a page", daemon=True)
        self._connect = connect
        self._source = name
        self._geometry = geometry
        self._token = token
        self._send = send
        self._changed = threading.Condition()
        """Held for an assignment at a time only: the pages' loop takes it, too."""
        self._wish: tuple[WalkWish, float] | None = (wish, time.monotonic())
        """And when it came."""
        self._then: list[Callable[[], None]] = []
        self._ending = False
        self._over = False
        self.spent = wish.press - 1
        """Wishes of this press, and older ones, move nothing any more."""
        self._obeyed = wish
        """The newest wish; what it asked for has been done."""
        self._height_m: float | None = None
        self._gait = wish.gait
        self._sits = True
        self._detail = ""
        self._received_s = self._pressed_s = time.monotonic()
        self._reported_s = 0.0

    # ---- the loop's side

    def take(self, wish: WalkWish) -> None:
        """In place of an older one."""
        with self._changed:
            self._wish = (wish, time.monotonic())
            self._changed.notify()

    def when_over(self, then: Callable[[], None], *, sits: bool) -> bool:
        """`sits`: sit down now. False where it is over: then nothing is called."""
        with self._changed:
            if self._over:
                return False
            self._ending = self._ending or sits
            self._then.append(then)
            return True

    # ---- its thread

    def run(self) -> None:
        """Walk until the robot sits, or an error ends it."""
        try:
            self._walk()
        except (GatewayError, ValueError, RuntimeError, zenoh.ZError) as error:
            self._fault(error)
        except Exception as error:
            _log.exception("the walk for %s ended by a fault", self._source)
            self._fault(error)
        finally:
            with self._changed:
                self._over = True
                then = list(self._then)
            self.spent = max(self.spent, self._obeyed.press)
            self._send(WalkMessage(press=self.spent, detail=self._detail))
            for each in then:
                each()

    def _walk(self) -> None:
        with closing(self._connect(self._source)) as client:
            client.carry(LentLease(client, self._token))
            walk = client.walk(self._obeyed.gait, self._geometry)
            walk.open()
            walk.hold_s, walk.rest_s = SILENT_S, SIT_S
            try:
                while self._goes_on(walk):
                    pass
            finally:
                walk.close(sits=False)

    def _goes_on(self, walk: Walk) -> bool:
        """One turn: the newest wish, or silence; whether there is another."""
        wish = self._next_wish()
        now_s = time.monotonic()
        silent_s = now_s - self._received_s
        try:
            if silent_s > SILENT_S:
                self.spent = max(self.spent, self._obeyed.press)
            elif wish is not None:
                self._obey(walk, wish, now_s)
            if self._ending or silent_s > SILENT_S + SIT_S:
                self._sit(walk)
            elif now_s - self._pressed_s > IDLE_S:
                self._detail = f"nothing was pressed for {IDLE_S:g} s, so it sits down"
                self._sit(walk)
        except (GatewayError, ValueError) as error:
            self._fault(error)
        if walk.error is not None:
            self._fault(walk.error)
            if not walk.state.lost or self._ending or silent_s > SILENT_S + SIT_S:
                return False
        if now_s - self._reported_s >= REPORT_S:
            self._reported_s = now_s
            self._report(walk)
        return not (self._sits and walk.state.posture in _DOWN)

    def _next_wish(self) -> WalkWish | None:
        with self._changed:
            if self._wish is None:
                self._changed.wait(TICK_S)
            if self._wish is None:
                return None
            (wish, self._received_s), self._wish = self._wish, None
            return wish

    def _obey(self, walk: Walk, wish: WalkWish, now_s: float) -> None:
        """Do what has changed. A wish of a press that is used up only shows that its page is there."""
        fresh = wish.press > self.spent
        velocity = Velocity(wish.forward_m_s, wish.left_m_s, wish.turn_rad_s) if fresh and not wish.sits else STILL
        before, self._obeyed = self._obeyed, wish
        if wish.press > before.press:
            self._detail = ""
            walk.start_again()
        if velocity.moves or wish.press > before.press:
            self._pressed_s = now_s
        if fresh and wish.sits:
            self._sit(walk)
        elif fresh and not self._ending:
            if wish.gait != self._gait:
                self._gait = wish.gait
                walk.walk_as(wish.gait)
            if self._sits or wish.height_m != self._height_m:
                self._sits, self._height_m = False, wish.height_m
                walk.stand(wish.height_m, wait=False)
        if not self._sits:
            walk.go(*velocity, wait=False)

    def _sit(self, walk: Walk) -> None:
        if not self._sits:
            self._sits = True
            self.spent = max(self.spent, self._obeyed.press)
            walk.sit(wait=False)

    def _fault(self, error: Exception) -> None:
        self._detail = str(error) or repr(error)
        self.spent = max(self.spent, self._obeyed.press)

    def _report(self, walk: Walk) -> None:
        state = walk.state
        self._send(
            WalkMessage(
                press=self._obeyed.press,
                id=self._obeyed.id,
                posture=state.posture,
                gait=state.gait,
                height_m=round(state.height_m, 4),
                commanded=[round(each, 4) for each in state.commanded],
                scaled=[round(each, 4) for each in state.scaled],
                limit=state.limit,
                lost=list(state.lost),
                detail=self._detail,
                waits=self._obeyed.press <= self.spent,
            )
        )
