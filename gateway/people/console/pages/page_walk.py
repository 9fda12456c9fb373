"""One page's walk: the page sends its wish 20 times a second, and a thread of its own walks by the newest one.

The thread uses `gateway.client.Walk` over a session of its own, with the page's lease. The pages' loop only stores the
wish and never waits for the thread, so no STOP ALL does either.

- Each wish is used once. When a page has sent none for `WISH_SILENT_S` (frozen, locked, without Wi-Fi, closed), the
  robot finishes its step and stands; after another `SIT_S` it sits down, and its servos are stopped.
- Each wish carries the number of its press. What ends a walk (silence, an error, a Stop) uses up the newest press: only
  a newer one moves the robot again.
- Without a press for `PRESSLESS_S` the robot sits down although wishes come: standing heats the servos.
- Setpoints carry the page's lease until the legs are stopped; only then is it released.
- If this process dies, the gateway's watchdog stops the legs.
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
from gateway.people.console.pages.page_messages import Message, WalkWish, walk_message
from gateway.people.walking.motion import Velocity
from gateway.people.walking.ride import Ride, Silences, Wish
from gateway.people.walking.words import ground_now

WISH_SILENT_S: Final = 0.25
"""Five missing wishes in a row."""
SIT_S: Final = 5.0
PRESSLESS_S: Final = 60.0
SILENCES: Final = Silences(hold_s=WISH_SILENT_S, rest_s=SIT_S, idle_s=PRESSLESS_S, halted_s=WISH_SILENT_S + SIT_S)
SETPOINTS_HZ: Final = 50.0
WISH_WAIT_S: Final = 0.05
"""How long the thread waits for a wish before it looks at the silence."""
REPORT_S: Final = 0.1

_log: Final = logging.getLogger(__name__)


class PageWalks:
    """The walks of one page, one after the other. On the event loop."""

    def __init__(
        self,
        connect: Callable[[str], Client],
        name: str,
        geometry: Geometry,
        terrain: str,
        send: Callable[[Message], None],
    ) -> None:
        """`connect` opens a session under a name and blocks; it is called on a thread."""
        self._loop = asyncio.get_running_loop()
        self.send = send
        self._new = partial(_WalkThread, name, partial(connect, name), geometry, terrain, self._send_later)
        self._walk: _WalkThread | None = None
        self._spent = -1
        """The newest press that has been used."""

    @property
    def active(self) -> bool:
        """Whether a walk of this page may run legs."""
        return self._walk is not None and self._walk.is_alive()

    def take(self, wish: WalkWish, token: str | None) -> None:
        """Store a fresh wish, or begin a walk by it. `token` is the page's lease; without it no walk begins."""
        if self._walk is not None:
            if self._walk.is_alive():
                self._walk.take(wish)
                return
            self._spent, self._walk = max(self._spent, self._walk.spent), None
        if wish.press <= self._spent or wish.sits:
            return
        self._spent = wish.press
        if token is None:
            self.send(walk_message(wish.press, "this page does not have the lease; press Drive first"))
            return
        walk = self._new(token, wish)
        try:
            walk.start()
        except RuntimeError as error:  # the system allows no further thread
            self.send(walk_message(wish.press, str(error)))
        else:
            self._walk = walk

    def when_over(self, then: Callable[[], None], *, sits: bool) -> None:
        """Call `then` once the legs are stopped. `sits`: sit down now; else the page's silence makes it sit."""
        if self._walk is None or not self._walk.when_over(partial(self._later, then), sits=sits):
            then()

    @property
    def newest_press(self) -> int:
        """The number of the newest press; only greater numbers are new presses."""
        return max(self._spent, 0 if self._walk is None else self._walk.newest.press)

    def _send_later(self, message: Message) -> None:
        self._later(lambda: self.send(message))

    def _later(self, call: Callable[..., None], *arguments: object) -> None:
        """Call on the loop; for the walk's thread."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(call, *arguments)


class _WalkThread(threading.Thread):
    """One walk, from the press that begins it until its servos are stopped. `Ride` decides what it does."""

    def __init__(
        self,
        name: str,
        connect: Callable[[], Client],
        geometry: Geometry,
        terrain: str,
        send: Callable[[Message], None],
        token: str,
        wish: WalkWish,
    ) -> None:
        super().__init__(name=name, daemon=True)
        self._connect = connect
        self._geometry, self._terrain = geometry, terrain
        self._send = send
        self._token = token
        self._changed = threading.Condition()
        """Held for an assignment at a time only, since the pages' loop takes it too."""
        self._wish: tuple[WalkWish, float] | None = (wish, time.monotonic())
        """The newest wish that was not used yet, and when it came."""
        self._then: list[Callable[[], None]] = []
        self._ending = False
        self._over = False
        self.spent = wish.press
        """Once it is over, wishes of this press and older ones move nothing."""
        self.newest = wish
        """The newest wish that was used."""

    # ---- called on the loop

    def take(self, wish: WalkWish) -> None:
        """Replace the wish before it."""
        with self._changed:
            self._wish = (wish, time.monotonic())
            self._changed.notify()

    def when_over(self, then: Callable[[], None], *, sits: bool) -> bool:
        """Call `then` at the end; `sits`: sit down now. False if it is over: then `then` is not called."""
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
                _log.exception("%s: ended by a fault", self.name)
            detail = str(error) or repr(error)
        finally:
            with self._changed:
                self._over = True
                then = list(self._then)
            self.spent = max(self.spent, self.newest.press)
            self._send(walk_message(self.spent, detail))
            for each in then:
                each()

    def _walk(self) -> str:
        """Returns why it has ended, in words."""
        with closing(self._connect()) as client:
            client.carry(LentLease(client, self._token))
            gait, silences = self.newest.gait, SILENCES
            walk = Walk(client, gait, self._geometry, SETPOINTS_HZ, silences=silences, once=True, terrain=self._terrain)
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
        """Give the ride the newest wish, or the page's end."""
        with self._changed:
            if self._wish is None:
                self._changed.wait(WISH_WAIT_S)
            taken, self._wish = self._wish, None
        if taken is not None:
            self.newest, came_s = taken
            wish = _wish(self.newest)
            walk.use(lambda ride, _: ride.wish(wish, came_s))
        if self._ending:
            walk.use(Ride.leave)

    def _report(self, walk: Walk, ride: Ride, _now_s: float) -> Message:
        state = ride.state
        return walk_message(
            self.newest.press,
            ride.detail,
            id=self.newest.id,
            posture=state.posture,
            now=walk.now,
            gait=state.gait,
            height_m=round(state.height_m, 4),
            commanded=[round(each, 4) for each in state.commanded],
            scaled=[round(each, 4) for each in state.scaled],
            limit=state.limit,
            lost=list(state.lost),
            ground=ground_now(state),
            waits=self.newest.press <= ride.spent,
        )


def _wish(wish: WalkWish) -> Wish:
    velocity = Velocity(wish.forward_m_s, wish.left_m_s, wish.turn_rad_s)
    return Wish(wish.press, velocity, wish.gait, wish.height_m, wish.sits)
