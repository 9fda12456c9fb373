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
from gateway.people.walking import Ride, Silences, Velocity, Wish

SILENT_S: Final = 0.25
"""Five wishes in a row are missing."""
SIT_S: Final = 5.0
IDLE_S: Final = 60.0
SILENCES: Final = Silences(hold_s=SILENT_S, rest_s=SIT_S, idle_s=IDLE_S, halted_s=SILENT_S + SIT_S)
HZ: Final = 50.0
TICK_S: Final = 0.05
"""How long a wish is waited for, before silence is looked at."""
REPORT_S: Final = 0.1

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
        self._ride: _PageWalk | None = None
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
        self._ride = _PageWalk(self._connect, self._name, self._geometry, token, wish, partial(self._later, self._send))
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


class _PageWalk(threading.Thread):
    """One walk, from the press that begins it until its servos are stopped. What it does is decided by `Ride`."""

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
        self.spent = wish.press
        """Wishes of this press, and older ones, move nothing any more once it is over."""
        self._newest = wish

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
        detail = ""
        try:
            detail = self._walk()
        except Exception as error:
            if not isinstance(error, GatewayError | ValueError | RuntimeError | zenoh.ZError):
                _log.exception("the walk for %s ended by a fault", self._source)
            detail = str(error) or repr(error)
        finally:
            with self._changed:
                self._over = True
                then = list(self._then)
            self.spent = max(self.spent, self._newest.press)
            self._send(WalkMessage(press=self.spent, detail=detail))
            for each in then:
                each()

    def _walk(self) -> str:
        """Returns why it has ended, for people."""
        with closing(self._connect(self._source)) as client:
            client.carry(LentLease(client, self._token))
            walk = Walk(client, self._newest.gait, self._geometry, HZ, silences=SILENCES, once=True)
            walk.open()
            try:
                reported_s = 0.0
                while not walk.is_over:
                    self._obey(walk)
                    if time.monotonic() - reported_s >= REPORT_S:
                        reported_s = time.monotonic()
                        self._send(walk.use(partial(self._report, walk)))
                return walk.use(lambda ride, _: ride.detail)
            finally:
                walk.close(sits=False)

    def _obey(self, walk: Walk) -> None:
        """The newest wish, or the page's end."""
        with self._changed:
            if self._wish is None:
                self._changed.wait(TICK_S)
            taken, self._wish = self._wish, None
        if taken is not None:
            self._newest, came_s = taken
            wish = _wish(self._newest)
            walk.use(lambda ride, _: ride.wish(wish, came_s))
        if self._ending:
            walk.use(Ride.leave)

    def _report(self, walk: Walk, ride: Ride, _now_s: float) -> WalkMessage:
        state = ride.state
        return WalkMessage(
            press=self._newest.press,
            id=self._newest.id,
            posture=state.posture,
            now=walk.now,
            gait=state.gait,
            height_m=round(state.height_m, 4),
            commanded=[round(each, 4) for each in state.commanded],
            scaled=[round(each, 4) for each in state.scaled],
            limit=state.limit,
            lost=list(state.lost),
            detail=ride.detail,
            waits=self._newest.press <= ride.spent,
        )


def _wish(wish: WalkWish) -> Wish:
    velocity = Velocity(wish.forward_m_s, wish.left_m_s, wish.turn_rad_s)
    return Wish(wish.press, velocity, wish.gait, wish.height_m, wish.sits)
