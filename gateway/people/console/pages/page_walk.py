"""One page's walk, and the camera by which somebody may drive it.

The page sends its wish 20 times a second, and a thread of its own walks by the newest one. The thread uses
`gateway.client.Walk` over a session of its own, with the page's lease. The pages' loop only stores the wish and never
waits for the thread, so no STOP ALL does either.

- Each wish is used once. When a page has sent none for `WISH_SILENT_S` (frozen, locked, without Wi-Fi, closed), the
  robot finishes its step and stands; after another `SIT_S` it sits down, and its servos are stopped.
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
from gateway.people.client.lease import LentLease
from gateway.people.client.walk import Walk
from gateway.people.console.link import Shared
from gateway.people.console.pages.page_messages import Message, WalkWish, walk_message
from gateway.people.walking.motion import Velocity
from gateway.people.walking.ride import Ride, Silences, Wish
from gateway.people.walking.words import ground_now
from gateway.people.watching.camera import Picture
from gateway.rate_limit import NS_PER_MS, NS_PER_S

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


class PageCamera:
    """The camera that one page shows, and whether somebody may drive by it. `now_ns`: the console's monotonic clock.

    The console decides by what it knows: a picture is shown once the page names it in its request for the next one. So
    a page that hangs, or whose picture does not arrive, moves nothing.
    """

    def __init__(self, stale_ms: float) -> None:
        """`stale_ms`: an older picture moves nothing; 0: any moves."""
        self._stale_ns = stale_ms * NS_PER_MS
        self._name: str | None = None
        self._taken_ns: int | None = None
        self.sent: Picture | None = None  # the newest one

    def show(self, name: str | None) -> None:
        """Record that the page shows this camera from now on; None: it shows none."""
        if name != self._name:
            self._name, self._taken_ns, self.sent = name, None, None

    def confirm(self, name: str, number: str) -> None:
        """Record that the page shows the picture of this number (`taken_ns`), if that was sent to it last."""
        if name == self._name and self.sent is not None and number == str(self.sent.taken_ns):
            self._taken_ns = self.sent.taken_ns

    def left_s(self, now_ns: int) -> float:
        """Return how long the picture may still be driven by; inf without a camera. For any thread."""
        taken_ns = self._taken_ns
        if self._name is None or not self._stale_ns:
            return float("inf")
        return 0.0 if taken_ns is None else max(0.0, (taken_ns + self._stale_ns - now_ns) / NS_PER_S)

    def bars(self, now_ns: int) -> str:
        """Return why nothing may be driven by the picture, without a full stop; "" if it may. For any thread."""
        taken_ns = self._taken_ns
        if self.left_s(now_ns):
            return ""
        if taken_ns is None:
            return "no picture was shown yet; wait for one, or hide the camera"
        return f"the picture was {(now_ns - taken_ns) / NS_PER_S:.1f} s old"


class PageWalks:
    """The walks of one page, one after the other, each on a thread. Called on the event loop."""

    def __init__(self, shared: Shared, name: str, send: Callable[[Message], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._shared = shared
        self._name = name
        self.send = send
        self.active = False
        """Whether a walk of this page may run legs."""
        self._changed = threading.Condition()
        """Held for an assignment at a time only, since the pages' loop takes it too."""
        self._camera = PageCamera(0)
        """The camera of the page that sent the newest wish."""
        self._wish: tuple[WalkWish, float] | None = None
        """The newest wish that was not used yet, and when it came."""
        self._newest: WalkWish
        """The newest wish that was used."""
        self._came_s = 0.0
        self._spent = -1
        """The newest press that is used up."""
        self._ending = False
        self._then: list[Callable[[], None]] = []

    def take(self, wish: WalkWish, token: str | None, camera: PageCamera) -> None:
        """Store a fresh wish, or begin a walk by it. `token` is the page's lease; without it no walk begins."""
        if not self.active and (wish.press <= self._spent or wish.sits):
            return
        with self._changed:
            self._wish, self._camera = (wish, time.monotonic()), camera
            self._changed.notify()
        if self.active:
            return
        self._newest, self._spent, self._ending = wish, wish.press, False
        barred = camera.bars(time.monotonic_ns()) if _velocity(wish).moves else ""
        why = "this page does not have the lease" if token is None else barred
        if token is None or why:
            self.send(walk_message(wish.press, why))
            return
        try:
            threading.Thread(target=self._run, args=(token,), name=self._name, daemon=True).start()
        except RuntimeError as error:  # the system allows no further thread
            self.send(walk_message(wish.press, str(error)))
        else:
            self.active = True

    def when_over(self, then: Callable[[], None], *, sits: bool) -> None:
        """Call `then` once the legs are stopped. `sits`: sit down now; else the page's silence makes it sit."""
        if self.active:
            self._ending = self._ending or sits
            self._then.append(then)
        else:
            then()

    @property
    def newest_press(self) -> int:
        """The number of the newest press; only greater numbers are new presses."""
        return max(self._spent, self._newest.press) if self.active else max(self._spent, 0)

    def _ended(self, detail: str) -> None:
        self.active = False
        self._spent = max(self._spent, self._newest.press)
        self.send(walk_message(self._spent, detail))
        then, self._then = self._then, []
        for each in then:
            each()

    # ---- the walk's thread; `Ride` decides what it does

    def _later(self, call: Callable[..., None], *arguments: object) -> None:
        """Call on the loop."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(call, *arguments)

    def _run(self, token: str) -> None:
        """Walk until the robot sits, or an error ends it."""
        detail = ""
        try:
            detail = self._walk(token)
        except Exception as error:
            if not isinstance(error, GatewayError | ValueError | RuntimeError | zenoh.ZError):
                _log.exception("%s: ended by a fault", self._name)
            detail = str(error) or repr(error)
        finally:
            self._later(self._ended, detail)

    def _walk(self, token: str) -> str:
        """Returns why it has ended, in words."""
        with closing(self._shared.link.connect(source=self._name)) as client:
            lease = LentLease(client, token)  # the client refers to it weakly
            client.carry(lease)
            geometry, terrain, silences = self._shared.geometry, self._shared.terrain, SILENCES
            gait, hz = self._newest.gait, SETPOINTS_HZ
            walk = Walk(client, gait, geometry, hz, terrain=terrain, silences=silences, once=True)
            walk.open()
            try:
                reported_s = 0.0
                while not walk.is_over:
                    self._obey(walk)
                    if time.monotonic() - reported_s >= REPORT_S:
                        reported_s = time.monotonic()
                        self._later(self.send, walk.use(partial(self._message, walk)))
                return walk.use(lambda ride, _: ride.detail)
            finally:
                walk.close(sits=False)

    def _obey(self, walk: Walk) -> None:
        """Give the ride the newest wish, that its picture is too old, or the page's end."""
        with self._changed:
            if self._wish is None:
                fresh_s = self._camera.left_s(time.monotonic_ns())
                self._changed.wait(min(WISH_WAIT_S, fresh_s or WISH_WAIT_S))
            taken, self._wish = self._wish, None
        if taken is not None:
            self._newest, self._came_s = taken
        barred, new = self._camera.bars(time.monotonic_ns()), self._newest
        if taken is not None or barred:
            wish = Wish(new.press, _velocity(new), new.gait, new.height_m, new.sits, barred)
            walk.use(lambda ride, _: ride.wish(wish, self._came_s))
        if self._ending:
            walk.use(Ride.leave)

    def _message(self, walk: Walk, ride: Ride, _now_s: float) -> Message:
        state = ride.state
        return walk_message(
            self._newest.press,
            ride.detail,
            **{name: getattr(state, name) for name in ("posture", "gait", "limit", "lost")},
            id=self._newest.id,
            now=walk.now,
            height_m=round(state.height_m, 4),
            commanded=[round(each, 4) for each in state.commanded],
            scaled=[round(each, 4) for each in state.scaled],
            ground=ground_now(state),
            waits=self._newest.press <= ride.spent,
        )


def _velocity(wish: WalkWish) -> Velocity:
    return Velocity(wish.forward_m_s, wish.left_m_s, wish.turn_rad_s)
