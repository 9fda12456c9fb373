"""The lease of a robot: while a program holds it, the gateway rejects the starts, sets and resets of all others.

The token is in commands only: in no error, log or `repr`.
"""

import math
import re
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, Protocol, Self
from weakref import WeakKeyDictionary, ref

import zenoh

from gateway.errors import GatewayError, LeaseError, LeaseLostError, ZenohError
from gateway.people.client import stopped
from gateway.people.client.lease_requests import Requests
from gateway.people.client.renewal import Holds, Renewal
from gateway.people.client.subscriptions import undeclare, weakly
from schemas.ack import Ack
from schemas.event import Event
from schemas.gateway_state import GatewayState
from schemas.telemetry import Telemetry
from schemas.words import Kind, Reason

if TYPE_CHECKING:
    from schemas.calibration import Calibration
    from schemas.lease import LeaseAck

TTL_MS: Final = 1000.0
"""The gateway's default (`lease.ttl_ms`), for an answer without it."""
CONFIRM_S: Final = 1.0
"""The longest wait for an answer that a program waits for. The watchdog (0.25 s) stops its legs earlier."""
RELEASE_S: Final = 0.5
"""The longest delay of a program's end by a release."""
TRY_AGAIN_S: Final = 0.3
"""The period of tries while waiting for a hand-over. Each event causes a try, too."""
_CHANGES: Final = (Kind.LEASE_ASKED, Kind.LEASE_RELEASED, Kind.LEASE_EXPIRED, Kind.LEASE_TAKEN)
_TOKEN: Final = re.compile("[0-9a-f]{32}")
NOT_OURS: Final = (Reason.NOT_HOLDER, Reason.NO_LEASE)


class DrivingClient(Protocol):
    """The client's part that leases, streams and walks use. The client's commands carry the lease."""

    name: str
    zid: str
    reset_command: str
    open_parts: WeakKeyDictionary[Any, None]

    @property
    def requests(self) -> Requests: ...
    @property
    def carried_lease(self) -> "Lease | None": ...
    @property
    def connected(self) -> bool: ...
    def carry(self, lease: "Lease") -> None: ...
    def check_open(self) -> None: ...
    def ask(self, key: str, payload: Mapping[str, Any], *, again: bool = False) -> Ack: ...
    def publish(self, key: str, payload: Mapping[str, Any]) -> None: ...
    def state(self, timeout_s: float | None = None) -> GatewayState: ...
    def calibration(self) -> "Calibration": ...
    def on_state(self, callback: Callable[[GatewayState], None]) -> "zenoh.Subscriber[None]": ...
    def on_event(self, callback: Callable[[Event], None]) -> "zenoh.Subscriber[None]": ...
    def on_telemetry(self, callback: Callable[[Telemetry], None]) -> "zenoh.Subscriber[None]": ...


class Lease:
    """The right to drive; made by `Client.lease`, used in a `with`.

    Inside it every command of the client carries the lease, also published ones and a stream's. A thread renews it for
    as long as the program uses it; the end of the `with` releases it. The watchdog stops legs as without a lease.

    After a loss (taken by force, or the link was cut for longer than `ttl_ms`) the next acknowledged command and the
    next `set` of a stream raise LeaseLostError. The gateway accepts Stops and the emergency stop from anyone, always.

    >>> with Client(endpoint, source="anna") as robot, robot.lease() as lease:
    ...     robot.start_leg(3, 90, 45, 120).accepted
    ...     with Client(endpoint, source="bert") as other:
    ...         other.set_leg(3, 91, 45, 120, check=False).reason
    ...     lease.holder
    True
    <Reason.NOT_HOLDER: 'not_holder'>
    'anna'
    """

    def __init__(
        self,
        client: DrivingClient,
        *,
        take: bool = False,
        wait_s: float = 0.0,
        source: str | None = None,
        on_lost: Callable[[LeaseLostError], None] | None = None,
        on_asked: Callable[[str], None] | None = None,
    ) -> None:
        """See `Client.lease`. @private"""
        self._client = client
        self._take = take
        self._wait_s = wait_s
        self._source = source
        self._on_lost = on_lost
        self._on_asked = on_asked
        self._lock = threading.Lock()
        self._renewal = Renewal()
        """Changed only with the lock held."""
        self.token: str | None = None
        """The token in our commands. It stays after a loss, so that the gateway rejects them. @private"""
        self._giving = threading.RLock()
        """Held during a hand-over, whose answer alone decides who holds the lease."""
        self._asked_s = 0.0
        self._answer: Future[LeaseAck] = Future()
        """The answer to the latest request of `acquire`."""
        self._news = threading.Event()
        self._asked_by: str | None = None
        self._subscribers: list[Any] = []
        self._thread = threading.Thread(target=_keep, args=(ref(self), self._news), name="renew the lease", daemon=True)
        self.holder = ""
        """Our name at the gateway: the certificate's person, else `source`, else the client's name."""
        self.verified = False
        """Whether that name was proved by a certificate."""

    def __enter__(self) -> Self:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()

    @property
    def held(self) -> bool:
        """Whether we hold the lease, by the gateway's latest answer."""
        return self._renewal.holds is Holds.YES

    @property
    def lost(self) -> LeaseLostError | None:
        """The error with which the lease was lost, or None."""
        return self._renewal.lost

    @property
    def ttl_ms(self) -> float:
        """The lease expires this many ms after the gateway last received a renewal or a command of ours."""
        return self._renewal.ttl_ms

    def hand_over(self, to: str) -> None:
        """Hand the lease over to `to`, who has `ttl_ms` to acquire it. Running legs keep running.

        Raises LeaseLostError if we no longer hold it, and LeaseError if `to` has not asked.
        """
        self.check()
        if (token := self.token) is None:
            raise LeaseError(Reason.NOT_HOLDER, "this lease is not held")
        with self._giving:
            self._renewal.gives = True
            try:
                ack = self._client.requests.release(token, to)
                if ack.accepted:
                    self._end(Holds.HANDED_OVER)
                    return
            finally:
                self._renewal.gives = False
        self.confirm()
        self.check()
        raise self._error(ack)

    # ---- begin and end; `with` calls them

    def acquire(self) -> Self:
        """Acquire and return it. Raises LeaseError if denied, DisconnectedError if no gateway answers. @private"""
        if self._renewal.holds is not Holds.NOT_YET:
            raise RuntimeError("a lease is used once; make a new one with `lease()`")
        if (other := self._client.carried_lease) is not None and other.held:
            raise RuntimeError("this client holds a lease already; a stream and a walk acquire one")
        self._subscribers.append(self._client.on_event(weakly(self._receive)))
        try:
            ack = self._acquired()
            if not _TOKEN.fullmatch(ack.lease or ""):
                raise LeaseError(Reason.LEASE_DENIED, "the reply has no token; is it a gateway's?", ack.holder)
            self.holder, self.verified = ack.holder or self._client.name, bool(ack.verified)
            with self._lock:
                self.token = ack.lease
                self._renewal.granted(ack.ttl_ms or TTL_MS, self._asked_s)
            self._client.carry(self)
            self._thread.start()
        except BaseException:
            self._end(Holds.RELEASED)
            self._give_back()
            raise
        return self

    def release(self) -> None:
        """Give it back, if it is held. Without an answer it expires by itself. @private"""
        token = self.token if self.held else None
        self._end(Holds.RELEASED)
        if token is not None:
            with suppress(ZenohError):
                self._client.requests.release(token, timeout_s=RELEASE_S)
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(RELEASE_S)  # Python aborts if it returns from Zenoh while the program ends

    # ---- for the client and its streams

    @property
    def elsewhere(self) -> bool:
        """See `Renewal.elsewhere`. @private"""
        return self._renewal.elsewhere

    def check(self) -> None:
        """Raise LeaseLostError if it was lost. @private"""
        if self.lost is not None:
            raise self.lost.with_traceback(None)

    def confirm(self) -> LeaseLostError | None:
        """Ask the gateway whether we still hold it. Return the error if not. @private"""
        with self._giving:
            if self.held:
                self._renew(CONFIRM_S)
        return self.lost

    def judge(self, ack: Ack) -> None:
        """If a command was rejected for its lease, ask if the lease is lost. Raises LeaseLostError if so. @private"""
        if not ack.accepted and ack.reason in NOT_OURS:
            self.confirm()
            self.check()

    # ---- the thread that renews

    def next_s(self) -> float | None:
        """Return how long to wait for the next renewal; None: it has ended. @private"""
        if self.held:
            return max(0.0, self._renewal.due_s - time.monotonic())
        if self.lost is not None:
            undeclare(self._subscribers)
            if self._on_lost is not None:
                self._on_lost(self.lost)
        return None

    def keep(self) -> None:
        """Renew it, and report who has asked for it. @private"""
        if self.held:
            self._renew(self._renewal.answer_s)
        who, self._asked_by = self._asked_by, None
        if who is not None and self._on_asked is not None and self.held:
            self._on_asked(who)

    def _renew(self, timeout_s: float) -> None:
        token, asked_s = self.token, time.monotonic()
        if token is None:
            return
        self._renewal.asked(asked_s)
        try:
            ack = self._client.requests.renew(token, timeout_s)
        except (GatewayError, zenoh.ZError):
            with self._lock:
                self._renewal.unanswered(time.monotonic())
        else:
            with self._lock:
                self._renewal.answered(ack, asked_s)
        if not self.held:
            self._news.set()

    def _receive(self, event: Event) -> None:
        """Take an event, on a Zenoh thread, which must not wait."""
        if event.kind == Kind.LEASE_ASKED and self.held:  # before, the request may be our own
            self._asked_by = event.source
        if event.kind in _CHANGES:
            self._news.set()

    # ---- the rest

    def _acquired(self) -> "LeaseAck":
        ack = self._request("take" if self._take else "acquire")
        end_s, asked = time.monotonic() + (0.0 if self._take else self._wait_s), None
        while ack.reason == Reason.LEASE_HELD and time.monotonic() < end_s:
            if ack.holder != asked:
                asked = ack.holder
                self._request("ask")
            self._news.wait(max(0.0, min(TRY_AGAIN_S, end_s - time.monotonic())))
            self._news.clear()
            ack = self._request("acquire")
        if not ack.accepted:
            raise self._error(ack)
        return ack

    def _error(self, ack: "LeaseAck") -> LeaseError:
        who, name = ack.holder, self._client.name
        same = ack.reason == Reason.LEASE_HELD and who == name  # another program, since we hold none
        detail = f"the lease is held by {stopped.sender(who, name, own=False)}" if same else ack.detail
        return LeaseError(ack.reason or "", detail or "", who)

    def _request(self, do: str) -> "LeaseAck":
        """Request `do` on a thread, which takes the answer even if a signal interrupts this call."""
        self._asked_s = time.monotonic()
        answer: Future[LeaseAck] = Future()
        self._answer = answer

        def ask() -> None:
            try:
                answer.set_result(self._client.requests.as_person(do, self._source))
            except BaseException as error:
                answer.set_exception(error)

        threading.Thread(target=ask, name=f"{do} the lease").start()
        return answer.result()

    def _give_back(self) -> None:
        """Release what the latest request is granted. Its token is known only from the answer, so wait for that."""
        with suppress(GatewayError, TimeoutError):  # without an answer the lease expires by itself
            token = "" if self._answer.exception(RELEASE_S) else self._answer.result().lease or ""
            if _TOKEN.fullmatch(token):
                self._client.requests.release(token, timeout_s=RELEASE_S)

    def _end(self, how: Holds) -> None:
        with self._lock:
            self._renewal.end(how)
            self.token = None
        self._news.set()
        undeclare(self._subscribers)


class LentLease(Lease):
    """A lease that another program acquires, renews and releases, for `Client.carry` in a program that drives for it.

    Commands that carry it prolong it. After a rejected one, it asks the gateway whether the lease is lost.
    """

    def __init__(self, client: DrivingClient, token: str) -> None:
        super().__init__(client)
        self.token = token
        self._renewal.granted(TTL_MS, -math.inf)

    def release(self) -> None:
        """Carry it no longer. Its owner releases it."""
        self._end(Holds.RELEASED)


def _keep(found: "ref[Lease]", news: threading.Event) -> None:
    """Renew a lease until it ends, or until its program has dropped it: then it expires."""
    while (lease := found()) is not None and (wait_s := lease.next_s()) is not None:
        del lease
        news.wait(wait_s)
        news.clear()
        if (lease := found()) is not None:
            lease.keep()


def own_lease(client: DrivingClient) -> Lease | None:
    """Acquire a lease for the time of a stream or a walk. Return None if the client has one.

    Raises LeaseError if somebody else drives, UnansweredError without an answer.
    """
    return Lease(client).acquire() if client.carried_lease is None else None
